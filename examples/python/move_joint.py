"""Moves a joint of the rover's arm, within 10 ms or not at all: python move_joint.py can:can0 rover.toml 2 0.5"""

import sys
import time

import cosmic_can

link, cluster, number, angle = sys.argv[1:]
with cosmic_can.open(link, cluster=cluster) as node:
    node.announce("joint")
    node.publish("joint", {"number": int(number), "angle": float(angle)}, deadline=0.01, validity=0.01)
    while not (counters := node.counters("joint"))["sent"] + counters["expired"]:
        time.sleep(0.001)
    print("sent" if counters["sent"] else "too late: not sent")
