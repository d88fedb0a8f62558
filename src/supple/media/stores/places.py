"""Locations of Zarr stores, folders or URLs of fsspec: opening them, and converting their errors to one sentence."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import warnings
from collections.abc import Coroutine, Iterator
from pathlib import Path
from typing import Any, Literal

from supple.errors import SuppleError, need, needed, said
from supple.media.files import PathLike, _refused, is_store, protocol_of, unreadable, unwritable

MARKER = "supple.json"
"""The file that marks the root of an unfinished output."""
_SPELLINGS = {"s3a": "s3", "gcs": "gs", "abfss": "abfs", "az": "abfs"}
"""Other names of protocols."""
_ATOMIC = {"s3", "gs", "abfs", "oci", "memory"}
"""Protocols whose stores write an object whole or not at all."""
_CLIENTS = {"adlfs", "aiobotocore", "aiohttp", "azure", "botocore", "fsspec", "gcsfs", "google", "ocifs", "paramiko"}
"""Packages whose errors mean that a store is unreachable, but are not OSErrors."""
_PATIENCE = 10  # seconds
_SETTLING = "supple waits for zarr"  # a task name, by which waiting tasks do not wait for each other


class Place:
    """The location of a Zarr store, existing or future: a folder, or a URL of fsspec.

    ``folder`` is its path in the local file system, None elsewhere; ``parts`` are the parts of its path from the root
    on, with links resolved, and equal for all spellings of an address. ``atomic`` is true if objects are written whole
    or not at all.
    """

    def __init__(self, address: PathLike) -> None:
        self.address = os.fspath(address)
        self.folder: Path | None = None
        needed("zarr", "Zarr stores", "zarr")
        protocol = protocol_of(self.address)
        if not protocol:
            self.folder = Path(os.path.abspath(self.address))
        else:
            need("zarr", "Zarr stores at addresses", "fsspec")
        if protocol in ("file", "local"):
            from fsspec.core import url_to_fs

            # fsspec's own writes to folders are not atomic, those of Zarr's local store are
            self.folder = Path(url_to_fs(self.address)[1])
        if self.folder is not None:
            self.parts = Path(os.path.realpath(self.folder)).parts
            self.atomic = True
        else:
            protocol, _, path = self.address.rpartition("::")[2].partition("://")
            root = _SPELLINGS.get(protocol.lower(), protocol.lower())
            self.parts = (root, *(part for part in path.split("/") if part))
            self.atomic = "::" not in self.address and root in _ATOMIC

    def store(self, *, read_only: bool) -> Any:
        """Return a zarr store: a LocalStore for a folder, else an FsspecStore."""
        from zarr.storage import FsspecStore, LocalStore

        if self.folder is not None:
            return LocalStore(self.folder, read_only=read_only)
        try:
            return FsspecStore.from_url(self.address.rstrip("/"), read_only=read_only)
        except ImportError as error:
            what = f"{protocol_of(self.address)}:// addresses need a package of their own ({error})"
            raise self.unreadable(what, "install it") from error
        except (ValueError, OSError) as error:
            raise self.unreadable(said(error), "check the address") from error

    def unreadable(self, reason: str, advice: str = "give a whole copy of it") -> SuppleError:
        """Return an error that names the store."""
        return unreadable(self.address, reason, advice)

    def unwritable(self, reason: str, advice: str) -> SuppleError:
        """Return an error that names the store."""
        return unwritable(self.address, reason, advice)

    def open(self) -> Any:
        """Open the array or group for reading, and return it."""
        import zarr
        from zarr.errors import NodeNotFoundError

        if self.folder is not None and not os.path.lexists(self.folder):
            raise self.unreadable("there is no such folder", "check the name")
        if self.folder is not None and not self.folder.is_dir():
            raise self.unreadable("it is no folder", "give the folder of a Zarr store")
        store = self.store(read_only=True)
        with self.reading("it is damaged"), quiet():
            try:
                return zarr.open(store, mode="r")
            except NodeNotFoundError as error:
                raise self.unreadable("there is no Zarr array or group", "check the name") from error

    @contextlib.contextmanager
    def reading(self, what: str) -> Iterator[None]:
        """Convert all errors of zarr, of its codecs and of clients to one sentence."""
        from numcodecs.errors import UnknownCodecError as OldUnknown
        from zarr.errors import UnknownCodecError

        try:
            yield
        except SuppleError:
            raise
        except (UnknownCodecError, OldUnknown) as error:
            name = said(error).rpartition(":")[2].strip(" '\"")
            what = f"it is compressed by {name!r}, which is not available"
            raise self.unreadable(what, "install that codec for zarr") from error
        except Exception as error:
            _settle()
            client = type(error).__module__.split(".")[0] in _CLIENTS
            missing = isinstance(error, FileNotFoundError | KeyError)
            if self.folder is None and (client or (isinstance(error, OSError) and not missing)):
                advice = "check the address, your rights and the network"
                raise self.unreadable(f"it cannot be reached ({said(error)})", advice) from error
            raise self.unreadable(f"{what} ({said(error)})") from error

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Convert errors of the file system, such as a full disk, and of clients to one sentence."""
        try:
            yield
        except SuppleError:
            raise
        except Exception as error:
            _settle()
            if isinstance(error, OSError):
                raise _refused(self.address, error) from error
            if isinstance(error, NotImplementedError) or type(error).__module__.split(".")[0] in _CLIENTS:
                raise self.unwritable(said(error), "choose another place") from error
            raise

    def marker(self) -> dict[str, Any]:
        """Return the content of the marker in the root; empty if there is none of Supple's."""
        with contextlib.suppress(Exception):  # an unreachable store is reported when it is opened
            store = self.store(read_only=True)
            refresh(store)
            content = json.loads(read(store, MARKER) or b"{}")
            if content["program"] == "supple":
                return {"job": content["job"], "state": content["state"]}
        return {}

    def check_finished(self) -> None:
        """Raise SuppleError for an output that is not finished."""
        if self.marker().get("state", "complete") != "complete":
            raise self.unreadable("it is an unfinished output of Supple", "run the command that writes it again")


def overlap(address: PathLike, other: PathLike) -> Literal["", "same", "inside", "around"]:
    """Return where an output lies relative to another store or file; empty if they do not overlap.

    A folder that is not a store, such as that of a series of slices, may contain outputs.
    """
    here, there = Place(address).parts, Place(other).parts
    if here == there:
        return "same"
    if there[: len(here)] == here:
        return "around"
    return "inside" if here[: len(there)] == there and is_store(other) else ""


def run(work: Coroutine[Any, Any, Any]) -> Any:
    """Run a coroutine of a store, and return its result."""
    from zarr.core.sync import sync

    return sync(work)


def refresh(store: Any) -> None:
    """Clear the cached listings of fsspec's client, as other processes write as well."""
    client = getattr(store, "fs", None)
    if client is not None:
        client.invalidate_cache()


def read(store: Any, key: str) -> bytes | None:
    """Return the bytes that a store holds for a key; None if the key is missing."""
    from zarr.core.buffer import default_buffer_prototype

    found = run(store.get(key, prototype=default_buffer_prototype()))
    return None if found is None else bytes(found.to_bytes())


def put(store: Any, key: str, data: bytes) -> None:
    """Write a key of a store."""
    from zarr.core.buffer import default_buffer_prototype

    run(store.set(key, default_buffer_prototype().buffer.from_bytes(data)))


def _settle() -> None:
    """Wait for writes that run in parallel to a failed one; otherwise Python reports them at exit."""

    async def waited() -> None:
        own = asyncio.current_task()
        assert own is not None
        own.set_name(_SETTLING)
        others = [task for task in asyncio.all_tasks() if task.get_name() != _SETTLING]
        if others:
            await asyncio.wait(others, timeout=_PATIENCE)

    run(waited())


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress warnings about codecs and names outside the specification, which the input has chosen."""
    from zarr.errors import UnstableSpecificationWarning, ZarrUserWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ZarrUserWarning)
        warnings.simplefilter("ignore", UnstableSpecificationWarning)
        yield
