import sys

import rover

for line in sys.stdin:
    at, _, frame = line.split()
    can_id, data = frame.split("#")
    event = rover.decode(int(can_id, 16), bytes.fromhex(data))
    # None is a frame of the protocol.
    if event is not None:
        print(at, event.publisher, event.channel.name, event.content)
