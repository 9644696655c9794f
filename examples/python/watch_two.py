"""Prints the events of two channels in one event loop: python watch_two.py can:can0 rover.toml attitude gripper"""

import asyncio
import sys

import cosmic_can


async def watch(node: cosmic_can.Node, channel: str) -> None:
    async for event in node.subscribe(channel):
        print(event, flush=True)


async def main(link: str, cluster: str, *channels: str) -> None:
    with cosmic_can.open(link, cluster=cluster) as node:
        await asyncio.gather(*(watch(node, channel) for channel in channels))


asyncio.run(main(*sys.argv[1:]))
