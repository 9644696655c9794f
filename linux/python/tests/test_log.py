"""Logs become columns of data frames."""

from __future__ import annotations

import struct
from pathlib import Path

import pandas
import polars
import pytest
from conftest import CLUSTER, ROOT

import cosmic_can

LOG = ROOT / "docs/tasks/late.log"


def test_all_frames() -> None:
    frame = pandas.DataFrame(cosmic_can.read_log(LOG, cluster=CLUSTER))
    assert list(frame) == ["time", "class", "priority", "tx_node", "node", "etag", "channel", "data", "text"]
    lines = LOG.read_text().splitlines()
    assert len(frame) == len(lines)
    assert frame["time"].is_monotonic_increasing
    assert set(frame["class"]) == {"HRT", "SRT", "NRT"}
    # The one that nobody planned.
    assert (frame["etag"] == 8192).sum() == 172
    first = frame.iloc[0]
    assert lines[0].endswith(first["data"].hex().upper())


def test_the_events_of_a_channel() -> None:
    frame = pandas.DataFrame(cosmic_can.read_log(LOG, cluster=CLUSTER, channel="left_wheel"))
    assert list(frame) == ["time", "tx_node", "node", "distance", "speed", "stalled"]
    assert len(frame) > 50 and set(frame["node"]) == {"left_motor"}
    assert frame["speed"].dtype == float and frame["stalled"].dtype == bool
    same = cosmic_can.read_log(LOG, cluster=CLUSTER, channel=0xB0A01C0000000002)
    assert pandas.DataFrame(same).equals(frame)


def test_polars_takes_the_same_columns(tmp_path: Path) -> None:
    rover = ROOT / "docs/tasks/rover.log"
    for log, channel in [(LOG, None), (LOG, "left_wheel"), (rover, "journal"), (rover, "gripper")]:
        columns = cosmic_can.read_log(log, cluster=CLUSTER, channel=channel)
        frame = polars.DataFrame(columns)
        assert frame.to_dict(as_series=False) == columns and frame.columns == list(pandas.DataFrame(columns))
        assert frame["time"].dtype == polars.Float64 and frame["tx_node"].dtype == polars.Int64
    assert frame["force"].dtype == polars.Float64 and set(frame["state"]) == {"holding"}


def test_without_a_file_of_the_cluster() -> None:
    columns = cosmic_can.read_log(LOG)
    assert len(columns["time"]) == len(LOG.read_text().splitlines())
    with pytest.raises(ValueError, match="give the cluster file"):
        cosmic_can.read_log(LOG, channel="left_wheel")
    assert list(cosmic_can.read_log(LOG, channel=0x2A)) == ["time", "tx_node", "node", "data"]


def test_malformed_events_have_no_values(tmp_path: Path) -> None:
    log = tmp_path / "a.log"
    # The etag and the TxNode of `drive` in the rover's plan; one byte too few, then as it should be.
    frame = pandas.DataFrame(cosmic_can.read_log(LOG, cluster=CLUSTER))
    etag = int(frame[frame["channel"] == "drive"]["etag"].iloc[0])
    identifier = 1 << 14 | etag
    length = len(frame[frame["channel"] == "drive"]["data"].iloc[0])
    log.write_text(f"(1.0) c {identifier:08X}#00\n(2.5) c {identifier:08X}#{'00' * length}\n")
    columns = cosmic_can.read_log(log, cluster=CLUSTER, channel="drive")
    assert columns["time"] == [1.0, 2.5] and columns["node"] == ["base", "base"]
    assert columns["mode"] == [None, "stop"] and columns["speed"] == [None, 0.0]


def test_a_message_of_several_frames_is_one_row() -> None:
    log = ROOT / "docs/tasks/rover.log"
    columns = cosmic_can.read_log(log, cluster=CLUSTER, channel="journal")
    assert list(columns) == ["time", "tx_node", "node", "at", "latitude", "longitude", "cells"]
    frames = pandas.DataFrame(cosmic_can.read_log(log, cluster=CLUSTER))
    assert 0 < len(columns["time"]) < (frames["channel"] == "journal").sum()
    assert set(columns["node"]) == {"base"} and columns["at"][0] == 0


def test_events_before_their_binding_are_known(tmp_path: Path) -> None:
    log = tmp_path / "a.log"
    event = "02810400#9C004E004A1F19"
    # For node 4 the broker binds the subject of `attitude` to etag 1024.
    binding = ["1F5FC004#04000400B0A01C00", "1F5FC004#0401040000000004"]
    frames = [event, *binding, event]
    log.write_text("".join(f"({number}.0) c {frame}\n" for number, frame in enumerate(frames, 1)))
    columns = cosmic_can.read_log(log, cluster=CLUSTER, channel="attitude")
    assert columns["time"] == [1.0, 4.0] and columns["roll"] == [1.56, 1.56]


def block(kind: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)


def test_pcapng(tmp_path: Path) -> None:
    log = tmp_path / "a.pcapng"
    packet = struct.pack(">IBBBB", 1 << 31 | 0x00625388, 2, 0, 0, 0) + b"\x08\x34"
    section = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
    interface = block(1, struct.pack("<HHI", 227, 0, 0))
    stamped = struct.pack("<IIIII", 0, 0, 2_500_000, len(packet), len(packet))
    log.write_bytes(section + interface + block(6, stamped + packet))
    columns = cosmic_can.read_log(log)
    assert columns["time"] == [2.5] and columns["data"] == [b"\x08\x34"]
    assert columns["etag"] == [5000] and columns["tx_node"] == [9] and columns["class"] == ["SRT"]


def test_what_is_no_log(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot be opened"):
        cosmic_can.read_log("/nowhere.log")
    log = tmp_path / "a.log"
    log.write_text("hello\n")
    with pytest.raises(ValueError, match="line 1: this is no frame of a log"):
        cosmic_can.read_log(log)
    log.write_bytes(b"\x0a\x0d\x0d\x0arubbish")
    with pytest.raises(ValueError):
        cosmic_can.read_log(log)
    with pytest.raises(ValueError, match="cannot be read"):
        cosmic_can.read_log(LOG, cluster="/nowhere.toml")
    with pytest.raises(TypeError, match="str, or by its subject"):
        cosmic_can.read_log(LOG, cluster=CLUSTER, channel=1.5)
    with pytest.raises(ValueError, match='no channel "wheel"'):
        cosmic_can.read_log(LOG, cluster=CLUSTER, channel="wheel")
