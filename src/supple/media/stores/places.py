"""Where Zarr stores lie: folders and addresses of fsspec, opened, and their errors in one sentence."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import warnings
from collections.abc import Coroutine, Iterator
from pathlib import Path
from typing import Any

from supple.errors import SuppleError, need, said
from supple.media.files import PathLike, _refused, nameless, protocol_of, unreadable, unwritable
from supple.media.transforms.omezarr import imported

MARKER = "supple.json"
"""The file in the root of an output that is being written."""
_WHAT = "Zarr stores"
_ATOMIC = {"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "oci", "memory"}
"""Protocols of stores in which an object appears whole or not at all."""
_CLIENTS = {"adlfs", "aiobotocore", "aiohttp", "azure", "botocore", "fsspec", "gcsfs", "google", "ocifs", "paramiko"}
"""Packages whose errors are no OSErrors, and say that a store was not reached."""
_PATIENCE = 10  # seconds
_SETTLING = "supple waits for zarr"  # by this name, two that wait do not wait for each other


class Place:
    """A folder, or an address of fsspec, that holds a Zarr store or will.

    Attributes
    ----------
    address : str
        As it was given.
    folder : pathlib.Path or None
        Where it lies in the local file system; None elsewhere.
    """

    def __init__(self, address: PathLike) -> None:
        self.address = os.fspath(address)
        self.folder: Path | None = None
        self.atomic = True
        imported(_WHAT)
        protocol = protocol_of(self.address)
        if not protocol:
            self.folder = Path(os.path.abspath(self.address))
            return
        need("zarr", f"{_WHAT} at addresses", "fsspec")
        self.atomic = protocol in _ATOMIC
        if protocol in ("file", "local"):
            from fsspec.core import url_to_fs

            # fsspec's own writes to folders are not atomic, those of Zarr's local store are
            self.folder = Path(url_to_fs(self.address)[1])

    def store(self, *, read_only: bool) -> Any:
        """Return the store, of a class of zarr's."""
        from zarr.storage import FsspecStore, LocalStore

        if self.folder is not None:
            return LocalStore(self.folder, read_only=read_only)
        try:
            return FsspecStore.from_url(self.address.rstrip("/"), read_only=read_only)
        except ImportError as error:
            what = f"{protocol_of(self.address)}:// addresses need a package of their own ({error})"
            raise unreadable(self.address, what, "install it") from error
        except (ValueError, OSError) as error:
            raise unreadable(self.address, said(error), "check the address") from error

    @property
    def parts(self) -> tuple[str, ...]:
        """Where it lies, from the root on, without links: the same for all spellings of an address."""
        if self.folder is not None:
            return Path(os.path.realpath(self.folder)).parts
        *chain, last = self.address.split("::")
        return Place(last).parts if chain else _parts(last)

    @property
    def identity(self) -> str:
        """The address in the one spelling that stands for all."""
        if self.folder is not None:
            return os.path.realpath(self.folder)
        root, *path = self.parts
        return "::".join([*self.address.split("::")[:-1], f"{root}://{'/'.join(path)}"])

    def parent(self) -> Place | None:
        """Return the place above; None if there is none."""
        if self.folder is not None:
            return Place(self.folder.parent)
        above = self.address.rstrip("/").rpartition("/")[0]
        return None if not above or above.endswith(("/", ":")) else Place(above)

    def unreadable(self, reason: str, advice: str = "give a whole copy of it") -> SuppleError:
        """Return an error that names the store."""
        return unreadable(self.address, reason, advice)

    def unwritable(self, reason: str, advice: str) -> SuppleError:
        """Return an error that names the store."""
        return unwritable(self.address, reason, advice)

    def open(self) -> Any:
        """Return the array or group, for reading."""
        import zarr
        from zarr.errors import NodeNotFoundError

        if self.folder is not None:
            mend(self.folder)
            if not os.path.lexists(self.folder):
                raise self.unreadable("there is no such folder", "check the name")
            if not self.folder.is_dir():
                raise self.unreadable("it is no folder", "give the folder of a Zarr store")
        store = self.store(read_only=True)
        try:
            with self.reading("it is damaged"), quiet():
                return zarr.open(store, mode="r")
        except SuppleError as error:
            if isinstance(error.__cause__, NodeNotFoundError):
                raise self.unreadable("there is no Zarr array or group", "check the name") from error.__cause__
            raise

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
            raise self.no_codec(error) from error
        except Exception as error:
            _settle()
            client = type(error).__module__.split(".")[0] in _CLIENTS
            if self.folder is None and (client or (isinstance(error, OSError) and not _is_missing(error))):
                advice = "check the address, your rights and the network"
                raise self.unreadable(f"it cannot be reached ({said(error)})", advice) from error
            raise self.unreadable(f"{what} ({said(error)})") from error

    def no_codec(self, error: Exception) -> SuppleError:
        """Return an error that names a codec that is not there."""
        name = said(error).rpartition(":")[2].strip(" '\"")
        return self.unreadable(f"it is compressed by {name!r}, which is not available", "install that codec for zarr")

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Convert errors of the file system, such as a full disk, and of clients to one sentence."""
        try:
            yield
        except SuppleError:
            raise
        except OSError as error:
            _settle()
            raise _refused(self.address, error) from error
        except Exception as error:
            _settle()
            if isinstance(error, NotImplementedError) or type(error).__module__.split(".")[0] in _CLIENTS:
                raise self.unwritable(said(error), "choose another place") from error
            raise

    def job(self) -> str | None:
        """Return the job of an unfinished output; None if there is none, or it is finished."""
        found = self.marker()
        return str(found["job"]) if found and found.get("state") != "complete" else None

    def marker(self) -> dict[str, Any] | None:
        """Return what the marker in the root holds; None if there is none of Supple's."""
        if self.folder is not None:
            try:
                data = (self.folder / MARKER).read_bytes()
            except OSError:
                return None
        else:
            try:
                store = self.store(read_only=True)
                refresh(store)
                found = read(store, MARKER)
            except Exception:  # what cannot be reached is told when the store itself is opened
                return None
            if found is None:
                return None
            data = found
        try:
            told = json.loads(data)
        except ValueError:
            return None
        return told if isinstance(told, dict) and told.get("program") == "supple" and "job" in told else None

    def check_finished(self) -> None:
        """Raise SuppleError for an output that is not finished."""
        if self.job() is not None:
            raise self.unreadable("it is an unfinished output of Supple", "run the command that writes it again")


def mend(path: PathLike) -> None:
    """Give an output its name back, if the process was killed between those."""
    if (old := nameless(path)) is not None:
        with contextlib.suppress(OSError):
            os.rename(old, os.path.realpath(path))


def run(work: Coroutine[Any, Any, Any]) -> Any:
    """Return what a coroutine of a store returns."""
    from zarr.core.sync import sync

    return sync(work)


def refresh(store: Any) -> None:
    """Forget what a client of fsspec has listed: other processes write as well."""
    client = getattr(store, "fs", None)
    if client is not None:
        client.invalidate_cache()


def read(store: Any, key: str) -> bytes | None:
    """Return what a store holds for a key; None if there is nothing."""
    from zarr.core.buffer import default_buffer_prototype

    found = run(store.get(key, prototype=default_buffer_prototype()))
    return None if found is None else bytes(found.to_bytes())


def put(store: Any, key: str, data: bytes) -> None:
    """Write a key of a store."""
    from zarr.core.buffer import default_buffer_prototype

    run(store.set(key, default_buffer_prototype().buffer.from_bytes(data)))


def _settle() -> None:
    """Wait for chunks that were written beside one that failed: else Python reports them when it ends."""

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
    """Leave out warnings about codecs and names that the specification does not have: they were chosen by others."""
    from zarr.errors import UnstableSpecificationWarning, ZarrUserWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ZarrUserWarning)
        warnings.simplefilter("ignore", UnstableSpecificationWarning)
        yield


def _parts(address: str) -> tuple[str, ...]:
    """Return the protocol, the host if that is no part of the path, and the path; nothing is reached."""
    from fsspec.registry import get_filesystem_class

    protocol, path = protocol_of(address), address.partition("://")[2]
    root: tuple[str, ...] = (protocol,)
    with contextlib.suppress(ImportError, ValueError):  # it is not installed, or there is none: no store can be there
        kind = get_filesystem_class(protocol)
        names, given = kind.protocol, kind._get_kwargs_from_urls(f"{protocol}://{path}")
        root = (names if isinstance(names, str) else names[0],)
        root += tuple(str(given[name]) for name in ("host", "account_name") if given.get(name))
        path = kind._strip_protocol(f"{protocol}://{path}")
    return (*root, *(part for part in path.split("/") if part))


def _is_missing(error: Exception) -> bool:
    return isinstance(error, FileNotFoundError | KeyError)
