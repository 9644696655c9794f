"""Prints the events of a channel as they come: python print_events.py can:can0 rover.toml left_wheel"""

import sys

import cosmic_can

link, cluster, channel = sys.argv[1:]
with cosmic_can.open(link, cluster=cluster) as node:
    for event in node.subscribe(channel):
        print(event, flush=True)
