"""Nodes exchange events on a simulated segment."""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import socket
import threading
import time
from pathlib import Path

import pytest
from conftest import PATIENCE, planned

import cosmic_can

ATTITUDE = {"roll": 1.25, "pitch": -0.5, "yaw": 90, "quality": 7, "calibrated": True}


def publish(node: cosmic_can.Node, channel: str, content: object, taker: cosmic_can.Subscription) -> cosmic_can.Event:
    """Publishes until the event has come: on a busy machine one may expire before it is sent."""
    for _ in range(100):
        node.publish(channel, content)
        event = taker.get(5)
        if event is not None:
            return event
        counters = node.counters(channel)
        assert counters["expired"] > 0, counters
    raise AssertionError("none has come")


def test_an_event_comes_decoded(base: cosmic_can.Node, imu: cosmic_can.Node) -> None:
    attitudes = base.subscribe("attitude")
    before = time.monotonic_ns()
    event = publish(imu, "attitude", ATTITUDE, attitudes)
    assert before <= event.received_ns <= time.monotonic_ns()
    assert event.fields == {"roll": 1.25, "pitch": -0.5, "yaw": 90.0, "quality": 7, "calibrated": True}
    assert event.units["roll"] == "°" and event.units["calibrated"] is None
    assert event["pitch"] == -0.5
    assert (event.channel, event.node, event.publisher) == ("attitude", "imu", 4)
    assert event.subject == 0xB0A01C0000000004 and event.malformed is None
    text = "attitude from imu: roll=1.25 ° pitch=-0.5 ° yaw=90 ° quality=7 calibrated=true"
    assert str(event) == text and repr(event) == f"<Event {text}>"
    with pytest.raises(KeyError, match='no field "rol"'):
        event["rol"]


def test_values_of_all_kinds(segment: cosmic_can.Segment, base: cosmic_can.Node) -> None:
    with planned(segment, 5) as arm, planned(segment, 6) as power:
        grippers, joints = base.subscribe("gripper"), arm.subscribe("joint")
        event = publish(arm, "gripper", {"state": "holding", "force": 1.05}, grippers)
        assert event.fields == {"state": "holding", "force": 1.05}
        event = publish(base, "joint", {"number": 3, "angle": 1e-5}, joints)
        assert event["number"] == 3 and event["angle"] == pytest.approx(1e-5)
        batteries = base.subscribe("battery")
        battery = {"voltage": 12.0000004, "current": -1, "temperature": 25, "charge": 80}
        assert publish(power, "battery", battery, batteries)["voltage"] == 12.0


def test_what_is_no_content_is_refused_with_a_reason(imu: cosmic_can.Node) -> None:
    for content, reason in [
        ({**ATTITUDE, "roll": "left"}, "roll"),
        ({**ATTITUDE, "rol": 1}, "rol is given twice, or is no field"),
        ({"roll": 1}, "pitch is missing"),
        ({**ATTITUDE, "quality": 11}, "quality"),
        ({**ATTITUDE, "roll": 1e9}, "roll"),
        ({**ATTITUDE, "roll": [1, 2]}, "roll"),
    ]:
        with pytest.raises(ValueError, match=reason):
            imu.publish("attitude", content)
    with pytest.raises(TypeError):
        imu.publish("attitude", 5)
    with pytest.raises(cosmic_can.NotPublishedError, match="not sent"):
        imu.publish("attitude", b"123456789")
    with pytest.raises(ValueError, match='no channel "atitude": names stand in the cluster file'):
        imu.publish("atitude", ATTITUDE)
    with pytest.raises(TypeError, match="str, or by its subject"):
        imu.publish(1.5, ATTITUDE)
    with pytest.raises(cosmic_can.NotPublishedError):
        imu.publish("attitude", ATTITUDE, deadline=0.01, validity=0.005)
    for wrong in [-1.0, float("nan"), float("inf"), 1e30]:
        with pytest.raises(ValueError, match="deadline is"):
            imu.publish("attitude", ATTITUDE, deadline=wrong)


def test_hard_real_time_is_received_only(base: cosmic_can.Node) -> None:
    with pytest.raises(cosmic_can.RefusedError, match="hard real-time"):
        base.publish("drive", {"speed": 1, "turn": 0, "mode": "drive", "lights": False})
    base.subscribe("left_wheel")


def test_malformed_content_is_said_to_be(base: cosmic_can.Node, imu: cosmic_can.Node) -> None:
    event = publish(imu, "attitude", b"\x01", base.subscribe("attitude"))
    assert event.data == b"\x01" and event.fields == {}
    assert event.malformed == "1 bytes instead of 7"
    assert "(malformed: 1 bytes instead of 7)" in str(event)


def test_a_channel_that_no_file_describes(segment: cosmic_can.Segment) -> None:
    quality = {"deadline": 0.05, "validity": 60.0, "etag": 5000}
    with (
        cosmic_can.open(segment.link, tx_node=7, patience=PATIENCE) as sensor,
        cosmic_can.open(segment.link, tx_node=8, patience=PATIENCE) as display,
    ):
        assert sensor.channels == [] and sensor.is_connected
        heats = display.subscribe(0x2A, **quality)
        sensor.announce("0x2A", **quality)
        event = publish(sensor, "0x2A", b"\x08\x34", heats)
        assert (event.channel, event.data, event.publisher) == ("0x2A", b"\x08\x34", 7)
        assert sensor.tx_node == 7 and sensor.withdraw(0x2A) and not sensor.withdraw(0x2A)
        assert set(sensor.counters(0x2B).values()) == {0} and isinstance(sensor.exceptions(), dict)
        latest, few = display.subscribe(0x2A, latest=True, **quality), display.subscribe(0x2A, depth=2, **quality)
        sensor.announce(0x2A, **quality)
        for number in range(10):
            sensor.publish(0x2A, bytes([number]))
            assert heats.get(PATIENCE) is not None
        assert [event.data[0] for event in iter(lambda: few.get(0), None)] == [0, 1]
        last = latest.get(0)
        assert last is not None and last.data == b"\x09"
        counters = display.counters(0x2A)
        assert (counters["overflowed"], counters["replaced"]) == (8, 9)
        with pytest.raises(cosmic_can.RefusedError):
            sensor.subscribe(0x2A, importance=1)
        for wrong in [{"importance": 5}, {"etag": 99}, {"deadline": 0}, {"deadline": 0.2, "validity": 0.1}]:
            with pytest.raises(ValueError):
                sensor.announce(0x99, **wrong)
        with pytest.raises(ValueError, match="give 1 to 255"):
            sensor.subscribe(0x2A, depth=0)


def test_messages_longer_than_a_frame(segment: cosmic_can.Segment) -> None:
    with (
        cosmic_can.open(segment.link, tx_node=7, patience=PATIENCE) as sensor,
        cosmic_can.open(segment.link, tx_node=8, patience=PATIENCE) as display,
    ):
        reports = display.subscribe(0x2C, messages=True, etag=5002)
        sensor.announce(0x2C, messages=True, etag=5002)
        for length in [0, 8, 9, 300, 1024]:
            content = bytes(number * 31 % 256 for number in range(length))
            event = publish(sensor, "0x2C", content, reports)
            assert (event.data, event.publisher) == (content, 7)
        with pytest.raises(cosmic_can.NotPublishedError, match="not sent"):
            sensor.publish(0x2C, bytes(1025))
        with pytest.raises(ValueError, match="no deadline"):
            sensor.publish(0x2C, b"", deadline=1)
        with pytest.raises(ValueError, match="no deadline"):
            sensor.announce(0x2D, messages=True, deadline=1)
        # Without the word for it, a channel has events of a frame.
        sensor.announce(0x2D, importance=4, etag=5003)
        with pytest.raises(cosmic_can.NotPublishedError, match="not sent"):
            sensor.publish(0x2D, bytes(9))


def test_messages_of_the_cluster_file(segment: cosmic_can.Segment, base: cosmic_can.Node) -> None:
    with planned(segment, 6) as power:
        journal = {"at": 12.0, "latitude": 47.5, "longitude": -8.25, "cells": [1, 2, 3, 4, 5, 6]}
        event = publish(base, "journal", journal, power.subscribe("journal"))
        assert event.fields == journal and len(event.data) > 8
        assert str(event).startswith("journal from base: at=12 s latitude=47.5 °")


def test_asyncio(base: cosmic_can.Node, imu: cosmic_can.Node) -> None:
    attitudes = base.subscribe("attitude")

    async def take(count: int) -> list[float]:
        taken = []
        async for event in attitudes:
            taken.append(event["roll"])
            if len(taken) == count:
                break
        return taken

    async def send(stop: asyncio.Event) -> None:
        number = 0
        await asyncio.to_thread(imu.announce, "attitude")
        while not stop.is_set():
            imu.publish("attitude", {**ATTITUDE, "roll": number % 100})
            number += 1
            await asyncio.sleep(0.001)

    async def run() -> None:
        assert await attitudes.get_async(0.01) is None
        stop = asyncio.Event()
        sender = asyncio.create_task(send(stop))
        # Two tasks wait for the same subscription; each event comes to one of them.
        first, second = await asyncio.wait_for(asyncio.gather(take(20), take(20)), PATIENCE)
        stop.set()
        await sender
        assert len(set(first + second)) == 40
        while attitudes.get(0) is not None:
            pass
        waiting = asyncio.create_task(take(1))
        await asyncio.sleep(0.01)
        base.close()
        assert await asyncio.wait_for(waiting, PATIENCE) == []

    asyncio.run(run())


def test_threads_and_closing(base: cosmic_can.Node, imu: cosmic_can.Node) -> None:
    attitudes = base.subscribe("attitude")
    taken: list[cosmic_can.Event] = []
    thread = threading.Thread(target=lambda: taken.extend(attitudes))
    thread.start()
    imu.announce("attitude")
    for _ in range(10000):
        imu.publish("attitude", ATTITUDE)
        if len(taken) >= 3:
            break
        time.sleep(0.002)
    attitudes.close()
    thread.join(PATIENCE)
    assert not thread.is_alive() and len(taken) >= 3
    with pytest.raises(cosmic_can.ClosedError):
        attitudes.get(0)
    base.close()
    base.close()
    with pytest.raises(cosmic_can.ClosedError):
        base.subscribe("attitude")


def test_a_subscription_can_be_selected(base: cosmic_can.Node, imu: cosmic_can.Node) -> None:
    with base.subscribe("attitude") as attitudes:
        assert select.select([attitudes], [], [], 0)[0] == []
        imu.announce("attitude")
        for _ in range(100):
            imu.publish("attitude", ATTITUDE)
            if select.select([attitudes], [], [], 5)[0]:
                break
        assert attitudes.get(0) is not None


def test_what_cannot_be_opened(tmp_path: Path) -> None:
    with pytest.raises(cosmic_can.LinkError, match="no server answers"):
        cosmic_can.open(f"sim:{tmp_path}/none", patience=0.05)
    with pytest.raises(cosmic_can.LinkError, match="cannot be opened"):
        cosmic_can.open("log:/nowhere.log")
    for wrong in ["can0", "usb:1", ""]:
        with pytest.raises(ValueError, match="write sim:PATH"):
            cosmic_can.open(wrong)
    for arguments in [{"tx_node": 127}, {"uid": 0}, {"bit_rate": 5}, {"patience": -1.0}, {"cluster": "/no.toml"}]:
        with pytest.raises(ValueError):
            cosmic_can.open("sim:/nowhere", **arguments)
    with pytest.raises(cosmic_can.LinkError):
        cosmic_can.Segment(tmp_path / "no/folder")


def test_a_closed_node_leaves_the_segment_though_a_subscription_lives(segment: cosmic_can.Segment) -> None:
    def sockets() -> int:
        count = 0
        for descriptor in os.listdir("/proc/self/fd"):
            with contextlib.suppress(FileNotFoundError):
                count += os.readlink(f"/proc/self/fd/{descriptor}").startswith("socket:")
        return count

    before = sockets()
    node = cosmic_can.open(segment.link, tx_node=7, patience=PATIENCE)
    heats = node.subscribe(0x2A, etag=5000)
    assert sockets() > before
    node.close()
    for _ in range(int(PATIENCE / 0.01)):
        if sockets() == before:
            break
        time.sleep(0.01)
    assert sockets() == before
    with pytest.raises(cosmic_can.ClosedError):
        heats.get(0)
    for what in (lambda: node.channels, lambda: node.tx_node, lambda: node.publish(0x2A, b"")):
        with pytest.raises(cosmic_can.ClosedError):
            what()


def test_who_subscribes_while_the_node_is_closed_is_told(segment: cosmic_can.Segment) -> None:
    # No broker gives it its TxNode, so it waits.
    node = cosmic_can.open(segment.link, patience=10 * PATIENCE)
    errors: list[BaseException] = []

    def subscribe() -> None:
        try:
            node.subscribe(0x2A)
        except cosmic_can.ClosedError as error:
            errors.append(error)

    thread = threading.Thread(target=subscribe)
    thread.start()
    time.sleep(0.05)
    node.close()
    thread.join(PATIENCE)
    assert not thread.is_alive() and len(errors) == 1


def test_the_socket_of_another_segment_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "segment"
    with cosmic_can.Segment(path) as first:
        with pytest.raises(cosmic_can.LinkError, match="another server answers there"):
            cosmic_can.Segment(path)
        with cosmic_can.open(first.link, tx_node=7, patience=PATIENCE) as node:
            assert node.is_connected
        # Somebody else takes the place.
        path.unlink()
        with socket.socket(socket.AF_UNIX) as other:
            other.bind(str(path))
            first.close()
            assert path.exists()
    path.unlink()
    with cosmic_can.Segment(path):
        assert path.exists()
    assert not path.exists()
    path.write_text("no socket")
    with pytest.raises(cosmic_can.LinkError, match="a file that is no socket"):
        cosmic_can.Segment(path)


def test_no_broker_answers(segment: cosmic_can.Segment) -> None:
    with cosmic_can.open(segment.link, patience=0.2) as node:
        with pytest.raises(cosmic_can.NotBoundError, match="no broker has answered"):
            node.publish(0x60, b"")
