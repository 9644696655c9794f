"""COSMIC: event channels on the CAN bus.

Four lines subscribe on any link and print decoded events::

    import cosmic_can

    with cosmic_can.open("can:can0", cluster="rover.toml") as node:
        for event in node.subscribe("left_wheel"):
            print(event)

Links: ``sim:PATH``, ``slcan:DEVICE``, ``socketcand:HOST:PORT[:BUS]``, ``can:INTERFACE``, ``log:FILE``. Times are in
seconds, from now. Calls block and may be made by any thread; a subscription is also an asynchronous iterator.
"""

from __future__ import annotations

import asyncio
import os
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Iterator, Mapping
from types import TracebackType
from typing import Any, TypeVar

from . import _native
from ._native import (
    ClosedError,
    CosmicError,
    Event,
    LinkError,
    NotBoundError,
    NotPublishedError,
    RefusedError,
    read_log,
)

__all__ = [
    "ClosedError",
    "CosmicError",
    "Event",
    "LinkError",
    "Node",
    "NotBoundError",
    "NotPublishedError",
    "RefusedError",
    "Segment",
    "Subscription",
    "open",
    "read_log",
]


def open(
    link: str,
    *,
    cluster: str | os.PathLike[str] | None = None,
    uid: int | None = None,
    tx_node: int | None = None,
    bit_rate: int = 1_000_000,
    patience: float = 5.0,
) -> Node:
    """Starts a node on a link, and waits until that is connected. A connection that is lost later is made again.

    cluster: the file that describes the cluster: gives names, contents, deadlines and etags.
    uid: the UID of the node; one is drawn if none is given. One of the cluster's file brings its TxNode.
    tx_node: the TxNode, where no broker gives one.
    bit_rate: where no file says it.
    patience: for how long calls wait for the link and for a broker.

    Raises ValueError, LinkError.
    """
    native = _native.Node(
        link,
        cluster=None if cluster is None else os.fspath(cluster),
        uid=uid,
        tx_node=tx_node,
        bit_rate=bit_rate,
        patience=patience,
    )
    return Node(native)


_Self = TypeVar("_Self", bound="_Closed")


class _Closed(ABC):
    """Closed at the end of a ``with``."""

    @abstractmethod
    def close(self) -> None: ...

    def __enter__(self: _Self) -> _Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class Node(_Closed):
    """A node on a segment, from :func:`open`. Use it in ``with``, or close it."""

    def __init__(self, native: _native.Node) -> None:
        self._native = native

    @property
    def channels(self) -> list[str]:
        """The names of the channels in the cluster's file."""
        return self._native.channels

    @property
    def tx_node(self) -> int | None:
        """The node's TxNode, if it has one."""
        return self._native.tx_node

    @property
    def is_connected(self) -> bool:
        """Whether the link is connected."""
        return self._native.is_connected

    def subscribe(
        self,
        channel: str | int,
        *,
        depth: int = 64,
        latest: bool = False,
        deadline: float | None = None,
        validity: float | None = None,
        importance: int | None = None,
        etag: int | None = None,
        messages: bool = False,
    ) -> Subscription:
        """Subscribes to a channel, by its name in the cluster's file or by its subject.

        depth: so many events may wait, 1 to 255; a further one is dropped and counted.
        latest: keeps only the latest event instead.
        The others: as for :meth:`announce`.

        Raises ValueError, RefusedError, NotBoundError.
        """
        if not 1 <= depth <= 255:
            raise ValueError(f"depth is {depth}: give 1 to 255")
        quality = _quality(deadline, validity, importance, etag, messages)
        return Subscription(self._native.subscribe(channel, 0 if latest else depth, quality))

    def announce(
        self,
        channel: str | int,
        *,
        deadline: float | None = None,
        validity: float | None = None,
        importance: int | None = None,
        etag: int | None = None,
        messages: bool = False,
    ) -> None:
        """Announces a channel, and waits until it can be published on.

        For a channel that no file describes: deadline and validity are those of soft real-time (20 ms, and four times
        the deadline, if they are not given); importance, 0 the most to 4, makes it non real-time; etag is the etag where
        there is no broker. messages: it is non real-time, and its events are messages of up to 1024 bytes, in as many
        frames as that takes; all who use the channel say so.

        Raises ValueError, RefusedError (always for a hard real-time channel), NotBoundError.
        """
        self._native.announce(channel, _quality(deadline, validity, importance, etag, messages))

    def publish(
        self,
        channel: str | int,
        content: bytes | Mapping[str, Any],
        *,
        deadline: float | None = None,
        validity: float | None = None,
    ) -> None:
        """Publishes an event of now. The first one on a channel announces it, and may wait for a broker; no other waits.

        content: bytes, or a value for each field of the content in the cluster's file.
        deadline: until it should have been sent; validity: until it is of no use any more; as the channel says if they
        are not given. An event has up to 8 bytes; on a channel of messages, which have no deadline, up to 1024, and up to
        8 messages wait behind the one that is being sent.

        Raises ValueError, NotPublishedError, and what :meth:`announce` raises.
        """
        if not isinstance(content, bytes):
            content = dict(content)
        self._native.publish(channel, content, deadline, validity)

    def withdraw(self, channel: str | int) -> bool:
        """Gives up an announcement. Events that wait to be sent are discarded. Returns whether there was one."""
        return self._native.withdraw(channel)

    def counters(self, channel: str | int) -> dict[str, int]:
        """What happened on a channel at this node: published, refused, sent, expired, delivered, overflowed, replaced,
        malformed."""
        return self._native.counters(channel)

    def exceptions(self) -> dict[str, int]:
        """How often something did not happen as promised, by kind."""
        return self._native.exceptions()

    def close(self) -> None:
        """Ends the node, with its subscriptions. Events that wait to be sent are discarded."""
        self._native.close()


class Subscription(_Closed):
    """Events of a channel, from :meth:`Node.subscribe`: iterate over it, with ``for`` or ``async for``.

    The iteration ends when the subscription or its node is closed. Any thread, and any task of any event loop, may take
    events; each comes to one of them.
    """

    def __init__(self, native: _native.Subscription) -> None:
        self._native = native

    def get(self, timeout: float | None = None) -> Event | None:
        """Waits for the next event; None if none has come within the timeout. Raises ClosedError."""
        return self._native.get(timeout)

    async def get_async(self, timeout: float | None = None) -> Event | None:
        """As :meth:`get`, in an event loop."""
        if timeout is None:
            return await self._next()
        try:
            return await asyncio.wait_for(self._next(), timeout)
        except asyncio.TimeoutError:
            return None

    def fileno(self) -> int:
        """A descriptor that is readable while an event waits, for select and its like. Not to be read from."""
        return self._native.fileno()

    def close(self) -> None:
        """Ends the subscription. Whoever waits is told."""
        self._native.close()

    def __iter__(self) -> Iterator[Event]:
        return self

    def __next__(self) -> Event:
        try:
            event = self._native.get(None)
        except ClosedError:
            raise StopIteration from None
        assert event is not None
        return event

    def __aiter__(self) -> AsyncIterator[Event]:
        return self

    async def __anext__(self) -> Event:
        try:
            return await self._next()
        except ClosedError:
            raise StopAsyncIteration from None

    async def _next(self) -> Event:
        while True:
            event = self._native.get(0.0)
            if event is not None:
                return event
            await _readable(self._native.fileno())


class Segment(_Closed):
    """A simulated segment in real time, to try things without hardware; other programs reach it by its link, too.

    path: where its socket is to be. Use it in ``with``, or close it.
    """

    def __init__(self, path: str | os.PathLike[str], *, bit_rate: int = 1_000_000) -> None:
        self._native = _native.Segment(os.fspath(path), bit_rate)

    @property
    def link(self) -> str:
        """What a node is to connect to."""
        return self._native.link

    def close(self) -> None:
        """Ends it. Nodes lose their connection."""
        self._native.close()


def _quality(
    deadline: float | None, validity: float | None, importance: int | None, etag: int | None, messages: bool
) -> dict[str, Any]:
    return {
        "deadline": deadline,
        "validity": validity,
        "importance": importance,
        "etag": etag,
        "messages": messages,
    }


async def _readable(descriptor: int) -> None:
    """Waits until a descriptor is readable. By a copy of it, for a loop has one waiter for each descriptor."""
    loop = asyncio.get_running_loop()
    readable = asyncio.Event()
    copy = os.dup(descriptor)
    loop.add_reader(copy, readable.set)
    try:
        await readable.wait()
    finally:
        loop.remove_reader(copy)
        os.close(copy)
