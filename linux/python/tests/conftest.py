"""A segment with nodes on it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import cosmic_can

ROOT = Path(__file__).parents[3]
CLUSTER = ROOT / "cosmic-plan/examples/rover.toml"
# Only bounds what hangs.
PATIENCE = 60.0


@pytest.fixture
def segment(tmp_path: Path) -> Iterator[cosmic_can.Segment]:
    with cosmic_can.Segment(tmp_path / "segment") as segment:
        yield segment


def planned(segment: cosmic_can.Segment, name: int) -> cosmic_can.Node:
    """A node of the rover: 1 is the base, 4 the sensor of attitude, 5 the arm."""
    uid = 0xB0A0000000000000 + name
    return cosmic_can.open(segment.link, cluster=CLUSTER, uid=uid, patience=PATIENCE)


@pytest.fixture
def base(segment: cosmic_can.Segment) -> Iterator[cosmic_can.Node]:
    with planned(segment, 1) as node:
        yield node


@pytest.fixture
def imu(segment: cosmic_can.Segment) -> Iterator[cosmic_can.Node]:
    with planned(segment, 4) as node:
        yield node
