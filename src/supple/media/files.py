"""Names of files in messages, and output files that appear whole or not at all, alone or many together."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
import sys
import time
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO

from supple.errors import SuppleError, argument, shown

PathLike = str | os.PathLike[str]
ROOTS = ("zarr.json", ".zgroup", ".zarray")
"""The names of metadata files; the root of a Zarr store has one of them."""
_NEW = os.O_CREAT | os.O_EXCL | os.O_WRONLY
_SPARE = 65_536  # bytes: with less, a disk counts as full
_ADVICE = {
    **dict.fromkeys((errno.ENOSPC, errno.EFBIG, errno.EDQUOT), "make room or choose another place"),
    **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), "choose a place where writing is allowed"),
    errno.ENAMETOOLONG: "choose a shorter name",
}


def unreadable(path: PathLike, reason: str, advice: str = "give a whole copy of it") -> SuppleError:
    """Return an error that explains in one sentence why a file cannot be read, with a remedy."""
    return SuppleError(f"cannot read {shown(path)}: {reason}: {advice}")


@contextlib.contextmanager
def refusing(refused: Callable[[Exception], Exception], *kinds: type[Exception]) -> Iterator[None]:
    """Raise ``refused(error)`` in place of an error of these kinds; SuppleErrors pass unchanged."""
    try:
        yield
    except SuppleError:
        raise
    except kinds as error:
        raise refused(error) from error


def head_of(
    path: PathLike,
    count: int,
    give: str = "give the name of a file",
    empty: str = "give a whole copy of it",
) -> bytes:
    """Return the first bytes of a file, or all if `count` is -1; SuppleError for an empty or special file."""
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise unreadable(path, "it is a folder or no plain file", give)
        with open(path, "rb") as file:
            head = file.read(count)
    except OSError as error:
        raise unreadable(path, error.strerror or str(error), "check the name and its rights") from error
    except SuppleError:
        raise
    except ValueError as error:
        raise unreadable(path, "no file can have that name", "check it") from error
    if not head:
        raise unreadable(path, "it is empty", empty)
    return head


def first_bytes(path: PathLike, count: int) -> bytes:
    """Return the first bytes of a file; ``b""`` if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return file.read(count)
    except (OSError, ValueError):
        return b""


def unwritable(path: PathLike, reason: str, advice: str) -> SuppleError:
    """Return an error that explains in one sentence why a file cannot be written, with a remedy."""
    return SuppleError(f"cannot write {shown(path)}: {reason}: {advice}")


def check_suffix(
    path: PathLike, suffix: str, known: Container[str], what: str, advice: str, verb: str = "write"
) -> None:
    """Raise SuppleError, which lists the valid suffixes, if a suffix in lower case is not in `known`."""
    if suffix.lower() not in known:
        found = f"the suffix {shown(suffix)}" if suffix else "a name without suffix"
        raise SuppleError(f"cannot {verb} {shown(path)}: {found} {what}: {advice}")


def check_output(path: PathLike, *, force: bool = False) -> Path:
    """Return the path of an output file, absolute and without links; raise SuppleError if it cannot be written.

    It cannot be if it exists and `force` is false; if it is a folder or a special file; if its folder is missing or
    read-only; or if its name is invalid.
    """
    name = shown(path)
    try:
        target = Path(os.path.realpath(path))
        folder, found = _mode(target.parent), _mode(target)
    except OSError as error:
        raise _refused(path, error) from error
    except ValueError as error:
        raise SuppleError(f"cannot write {name}: no file can have that name: choose another") from error
    if folder is None:
        raise SuppleError(f"cannot write {name}: there is no folder {shown(target.parent)}: make it first")
    if found is not None and stat.S_ISDIR(found):
        raise SuppleError(f"cannot write {name}: it is a folder: give the name of a file in it")
    if found is not None and not stat.S_ISREG(found):
        raise SuppleError(f"cannot write {name}: it is no plain file: give another name")
    if found is not None and not force:
        raise _exists(path)
    effective = os.access in os.supports_effective_ids
    if not os.access(target.parent, os.W_OK | os.X_OK, effective_ids=effective):
        raise _refused(path, PermissionError(errno.EACCES, "no right to write into its folder"))
    return target


def is_store(address: PathLike) -> bool:
    """Return whether a name is that of a Zarr store: an address of fsspec, a folder with one, or ``NAME.zarr``."""
    text = os.fspath(address)
    if protocol_of(text) or text.rstrip("/").lower().endswith(".zarr"):
        return True
    return is_zarr(text)


def is_zarr(path: PathLike) -> bool:
    """Return whether a folder is a Zarr store."""
    return any(os.path.isfile(os.path.join(path, name)) for name in ROOTS)


def protocol_of(address: str) -> str:
    """Return the protocol of an address of fsspec, the first of a chain; empty for a path."""
    return address.partition("::")[0].partition("://")[0].lower() if "://" in address else ""


def check_store(path: PathLike, *, force: bool = False) -> Path:
    """Raise SuppleError for a Zarr store, a folder, that cannot be written; return its path: absolute, without links.

    With `force`, an existing Zarr store may be replaced, but no other folder or file.
    """
    try:
        target = Path(os.path.realpath(path))
        there = os.path.lexists(target)
    except ValueError:
        return check_output(path)  # raises its error for an invalid name
    if not there:
        return check_output(path)
    if not force:
        raise _exists(path)
    if not is_zarr(target):
        raise unwritable(path, "what is there is no Zarr store", "give another name")
    return target


@contextlib.contextmanager
def replacing(path: PathLike, *, force: bool = False) -> Iterator[Path]:
    """Write a temporary file beside its target, and rename it when it is complete.

    Yields a new, empty, hidden file in the folder of the target, with its suffix; if the block ends early, by an
    interrupt too, it is removed. A link is kept, and its target replaced, with its permission bits. SuppleError as in
    `check_output`, if a file of that name has appeared meanwhile, and for every `OSError` of the block, such as a full
    disk.
    """
    target = check_output(path, force=force)
    # 40 characters: the suffixes are kept, and a long name stays within the file system's limit
    temporary = target.with_name(f".{os.urandom(6).hex()}-{target.name[-40:]}")
    try:
        # created here: this tests the right to write, and takes the permission bits from the umask
        os.close(os.open(temporary, _NEW, 0o666))
        yield temporary
        with open(temporary, "rb+") as file:
            os.fsync(file.fileno())  # a full disk is reported here, before the rename
        if not _publish(temporary, target, force):
            raise _exists(path)
    except OSError as error:
        # Libraries report a full disk with other errors.
        limit = error.errno in (errno.EFBIG, errno.EDQUOT)
        raise _refused(path, _full() if not limit and _is_full(temporary.parent) else error, temporary) from error
    except SuppleError as error:
        if str(error).startswith("cannot write") and _is_full(temporary.parent):
            raise _refused(path, _full()) from error
        if shown(temporary) in str(error):
            raise type(error)(str(error).replace(shown(temporary), shown(path))) from error
        raise
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def locked(path: Path) -> IO[bytes] | None:
    """Return a file that is locked while it is open; None if it is already locked."""
    file = open(path, "ab")  # noqa: SIM115, closing it is what unlocks it
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        file.close()
        return None
    except OSError:
        pass  # a file system without locks: the file counts as unlocked
    return file


def _is_full(folder: Path) -> bool:
    """Return whether a disk is full, while the incomplete file is still there."""
    try:
        return shutil.disk_usage(folder).free < _SPARE
    except OSError:
        return False


def _full() -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _mode(path: Path) -> int | None:
    """Return the mode of a file; None if there is none."""
    try:
        return os.lstat(path).st_mode
    except FileNotFoundError:
        return None


def _publish(temporary: Path, target: Path, force: bool) -> bool:
    """Rename the complete file, unless the name exists and `force` is false; return whether it was renamed."""
    if force:
        mode = _mode(target)
        if mode is not None:
            os.chmod(temporary, mode & 0o777)
        os.replace(temporary, target)
        return True
    try:
        os.link(temporary, target)  # atomic, and fails if the name exists
    except OSError:  # it exists, or the file system has no links: reserve the name first
        try:
            os.close(os.open(target, _NEW, 0o666))
        except FileExistsError:
            return False
        try:
            os.replace(temporary, target)
        except BaseException:
            target.unlink()
            raise
    return True


def _exists(path: PathLike) -> SuppleError:
    return SuppleError(f"{shown(path)} exists already: choose another name, or {argument('force', True)}")


def _refused(path: PathLike, error: OSError, temporary: Path | None = None) -> SuppleError:
    """Return an error that explains in one sentence why a file could not be written, with a remedy."""
    reason = error.strerror or str(error) or type(error).__name__
    if temporary is not None and error.filename not in (None, temporary, str(temporary)):
        reason += f" ({shown(os.fsdecode(error.filename))})"  # the error of another file
    advice = _ADVICE.get(error.errno or 0, "choose another place")
    return SuppleError(f"cannot write {shown(path)}: {reason}: {advice}")


def check_outputs(paths: Iterable[Path], *, force: bool = False) -> None:
    """Raise SuppleError for output files of one folder that cannot be written; the folder itself may be missing."""
    for path in paths:
        if not os.path.lexists(path.parent):
            check_output(path.parent)
            return
        check_output(path, force=force)


@contextlib.contextmanager
def replacing_all(folder: Path, *, force: bool = False) -> Iterator[Path]:
    """Write files into a hidden folder, and move them to ``folder`` when all are complete.

    A missing folder is created; its parent must exist. Yields a new, empty, hidden folder in it, or beside its future
    place; if the block ends early, by an interrupt too, it is removed and nothing else changes. SuppleError if a file
    of the same name has appeared meanwhile and `force` is false, and for every `OSError`.
    """
    place = Path(os.path.realpath(folder))
    new = not os.path.lexists(place)
    token = f".{os.urandom(6).hex()}-{place.name[-40:]}"
    temporary = (place.parent if new else place) / token  # on the same file system
    try:
        temporary.mkdir()
        yield temporary
        if new and not os.path.lexists(place):
            os.rename(temporary, place)
        else:
            names, backup = sorted(os.listdir(temporary)), temporary / "replaced"
            backup.mkdir()
            publish_all([(temporary / n, place / n, folder / n, backup / n) for n in names], force)
    except OSError as error:
        reason = error.strerror or str(error) or type(error).__name__
        raise SuppleError(f"cannot write into {shown(folder)}: {reason}: choose another place") from error
    finally:
        for pause in (0.05, 0.2, 0.5, 1.0):
            shutil.rmtree(temporary, ignore_errors=True)
            if not os.path.lexists(temporary):
                break
            time.sleep(pause)  # after an interrupt, a thread may still write a file into it


@contextlib.contextmanager
def replacing_together(paths: Sequence[PathLike], *, force: bool = False) -> Iterator[list[Path]]:
    """Write several files or folders (.zarr), in any folders, which appear together or not at all.

    Yields, for each, a name in a hidden folder beside its place, where the block is to write it; if the block ends
    early, by an interrupt too, all are removed. In the block's SuppleErrors, the hidden names are replaced by `paths`.
    SuppleError as in `check_output` or `check_store`, and if two paths are the same file.
    """
    checks = (check_store if Path(path).suffix.lower() == ".zarr" else check_output for path in paths)
    targets = [check(path, force=force) for check, path in zip(checks, paths, strict=True)]
    for i, target in enumerate(targets):
        if target in targets[:i]:
            raise SuppleError(f"{shown(paths[i])} is to be written twice: give each output a name of its own")
    token, folders = os.urandom(6).hex(), []
    try:
        for i, target in enumerate(targets):
            folder = target.parent / f".{token}-{i}"
            folder.mkdir()
            folders.append(folder)
        hidden = [folder / target.name for folder, target in zip(folders, targets, strict=True)]
        yield hidden
        made = [each for each in zip(hidden, targets, paths, strict=True) if os.path.lexists(each[0])]
        publish_all([(*each, each[0].with_name(f".{token}-before")) for each in made], force)
    except OSError as error:
        name = next((p for p, folder in zip(paths, folders, strict=False) if str(folder) in str(error)), paths[0])
        raise _refused(name, error) from error
    except SuppleError as error:
        text = str(error)
        for path, folder, target in zip(paths, folders, targets, strict=False):
            text = text.replace(shown(folder / target.name), shown(path))
        if text == str(error):
            raise
        raise type(error)(text) from error
    finally:
        for folder in folders:
            shutil.rmtree(folder, ignore_errors=True)


def publish_all(moves: Iterable[tuple[Path, Path, PathLike, Path]], force: bool) -> None:
    """Move all files, or none; a move is (file, target, name for messages, backup path of a replaced target)."""
    moved: list[tuple[Path, Path]] = []
    try:
        for made, target, name, aside in moves:
            if os.path.lexists(target):
                if not force:
                    raise _exists(name)
                mode, own = os.lstat(target).st_mode, os.lstat(made).st_mode
                if stat.S_ISDIR(mode) and not stat.S_ISDIR(own):
                    raise OSError(errno.EISDIR, f"{shown(name)} is a folder")
                if stat.S_ISREG(mode) or stat.S_ISDIR(mode):
                    os.chmod(made, (own & ~0o777) | (mode & 0o777))
                moved.append((target, aside))  # noted first: an interrupt may come between
                os.rename(target, aside)
            moved.append((made, target))
            os.rename(made, target)
    except BaseException:
        for before, after in reversed(moved):
            # A file that was noted but not moved is still in its place.
            if not os.path.lexists(before):
                os.rename(after, before)
        raise


def same_file(one: PathLike, other: PathLike) -> bool:
    """Return whether two paths are the same existing file."""
    try:
        return os.path.samefile(one, other)
    except (OSError, ValueError):
        return False
