"""The far end of a link, by python-can: answers each event of etag 5000 with one of etag 5001.

    python_can.py slcan N       two pseudo terminals, joined like the ends of a cable; prints the path of one
    python_can.py socketcand N  a small server with two clients, of which python-can is one; prints its address

Ends when it has answered N events, with status 0 if all were as they should be.
"""

import os
import select
import socket
import sys
import termios
import threading
import tty

import can


def join_terminals():
    """Two pseudo terminals; what is written to one can be read from the other."""
    pairs = [os.openpty() for _ in range(2)]
    for _, slave in pairs:
        tty.setraw(slave, termios.TCSANOW)
    masters = [master for master, _ in pairs]

    def relay():
        while True:
            for ready in select.select(masters, [], [])[0]:
                other = masters[1 - masters.index(ready)]
                data = os.read(ready, 4096)
                while data:
                    data = data[os.write(other, data):]

    threading.Thread(target=relay, daemon=True).start()
    return [os.ttyname(slave) for _, slave in pairs]


def hub():
    """A socketcand server: what one client sends, the other receives."""
    server = socket.create_server(("127.0.0.1", 0))
    raw = []

    def words(client):
        text = b""
        while chunk := client.recv(4096):
            text += chunk
            while b">" in text:
                command, text = text.split(b">", 1)
                yield command.strip(b" <").decode().split()

    def serve(client):
        client.sendall(b"< hi >")
        for command in words(client):
            if command[0] in ("open", "rawmode"):
                if command[0] == "rawmode":
                    raw.append(client)
                client.sendall(b"< ok >")
            elif command[0] == "send":
                line = "< frame %s 1.000000 %s >" % (command[1], "".join(byte.zfill(2) for byte in command[3:]))
                for other in raw:
                    if other is not client:
                        other.sendall(line.encode())

    def accept():
        while True:
            client, _ = server.accept()
            threading.Thread(target=serve, args=(client,), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    return server.getsockname()


def main():
    kind, wanted = sys.argv[1], int(sys.argv[2])
    if kind == "slcan":
        near, far = join_terminals()
        bus = can.Bus(interface="slcan", channel=near, bitrate=1000000, sleep_after_open=0)
        print(far, flush=True)
    else:
        host, port = hub()
        bus = can.Bus(interface="socketcand", host=host, port=port, channel="can0")
        print(f"{host}:{port}", flush=True)
    answered = 0
    while answered < wanted:
        frame = bus.recv(timeout=60)
        if frame is None:
            sys.exit(f"nothing came behind {answered} events")
        etag, node = frame.arbitration_id & 0x3FFF, frame.arbitration_id >> 14 & 0x7F
        if etag != 5000:
            continue
        if not frame.is_extended_id or node != 7 or len(frame.data) != 2:
            sys.exit(f"not as it should be: {frame}")
        # Non real-time, from node 9.
        identifier = 0xFF << 21 | 9 << 14 | 5001
        bus.send(can.Message(arbitration_id=identifier, is_extended_id=True, data=frame.data))
        answered += 1
    # The other side reads until it has all; it then ends this program.
    sys.stdin.read()


main()
