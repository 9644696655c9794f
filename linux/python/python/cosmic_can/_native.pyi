"""Types of the part in Rust."""

import os
from typing import Any

class CosmicError(Exception):
    """Something did not work; its subclasses say what."""

class LinkError(CosmicError):
    """The segment cannot be reached."""

class NotBoundError(CosmicError):
    """No broker has given the node its TxNode, or the channel its etag."""

class RefusedError(CosmicError):
    """The node cannot announce or subscribe to the channel."""

class NotPublishedError(CosmicError):
    """The event is not sent."""

class ClosedError(CosmicError):
    """The node or the subscription has been closed."""

class Event:
    """An event of a channel. ``event["speed"]`` is a field of it; ``str(event)`` says all of it."""

    @property
    def channel(self) -> str:
        """The name of the channel, or its subject in hexadecimal digits."""
    @property
    def subject(self) -> int: ...
    @property
    def publisher(self) -> int:
        """The TxNode of its publisher."""
    @property
    def node(self) -> str | None:
        """The name of its publisher in the cluster's file."""
    @property
    def received_ns(self) -> int:
        """When it arrived, in nanoseconds of time.monotonic_ns()."""
    @property
    def data(self) -> bytes: ...
    @property
    def fields(self) -> dict[str, Any]:
        """The values of its fields: bool, int, float, str for a value with a name, or a list of these."""
    @property
    def units(self) -> dict[str, str | None]: ...
    @property
    def malformed(self) -> str | None:
        """Why the content could not be decoded."""
    def __getitem__(self, name: str) -> Any: ...

class Node:
    def __init__(
        self,
        link: str,
        *,
        cluster: str | None,
        uid: int | None,
        tx_node: int | None,
        bit_rate: int,
        patience: float,
    ) -> None: ...
    @property
    def channels(self) -> list[str]: ...
    @property
    def tx_node(self) -> int | None: ...
    @property
    def is_connected(self) -> bool: ...
    def announce(self, channel: str | int, quality: dict[str, Any]) -> None: ...
    def withdraw(self, channel: str | int) -> bool: ...
    def publish(
        self,
        channel: str | int,
        content: bytes | dict[str, Any],
        deadline: float | None = None,
        validity: float | None = None,
    ) -> None: ...
    def subscribe(self, channel: str | int, depth: int, quality: dict[str, Any]) -> Subscription: ...
    def counters(self, channel: str | int) -> dict[str, int]: ...
    def exceptions(self) -> dict[str, int]: ...
    def close(self) -> None: ...

class Subscription:
    def get(self, timeout: float | None = None) -> Event | None: ...
    def fileno(self) -> int: ...
    def close(self) -> None: ...

class Segment:
    def __init__(self, path: str, bit_rate: int) -> None: ...
    @property
    def link(self) -> str: ...
    def close(self) -> None: ...

def read_log(
    path: str | os.PathLike[str],
    *,
    cluster: str | os.PathLike[str] | None = None,
    channel: str | int | None = None,
) -> dict[str, list[Any]]:
    """Reads a log, candump or pcapng, into columns: ``pandas.DataFrame(read_log(...))``, and so for polars.

    Without a channel: a row for each frame, with time (seconds since 1970), class, priority, tx_node, node, etag,
    channel, data, and text, which says what it means.
    With a channel, by name or subject: a row for each event of it, with time, tx_node, node, and a column for each
    field of its content; or data, if no cluster file describes it. A field that is called as a column that is there
    becomes content.NAME. A malformed event has None in its fields.

    Raises ValueError.
    """
