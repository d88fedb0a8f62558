"""Output files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

from supple.errors import SuppleError, shown

_NEW = os.O_CREAT | os.O_EXCL | os.O_WRONLY
_SPARE = 65_536  # bytes: with less, a disk is full
_NO_ROOM = "make room or choose another place"
_NO_RIGHT = "choose a place where writing is allowed"
_ADVICE = {
    errno.ENOSPC: _NO_ROOM,
    errno.EFBIG: _NO_ROOM,
    errno.EDQUOT: _NO_ROOM,
    errno.EACCES: _NO_RIGHT,
    errno.EPERM: _NO_RIGHT,
    errno.EROFS: _NO_RIGHT,
    errno.ENAMETOOLONG: "choose a shorter name",
}


def check_output(path: str | os.PathLike[str], *, force: bool = False) -> Path:
    """Refuse an output file that cannot be written, before any work is done for it.

    Parameters
    ----------
    path : str or os.PathLike
        The file to write. A link stands for the file it points at.
    force : bool
        Whether a file that exists already may be replaced.

    Returns
    -------
    pathlib.Path
        Where the file really goes: absolute, without links.

    Raises
    ------
    SuppleError
        The file exists already and `force` is false; it is a folder, or no plain file; its folder is missing
        or may not be written to; no file can have such a name.
    """
    name = shown(path)
    try:
        target = Path(os.path.realpath(path))
        folder, found = _mode(target.parent), _mode(target)
    except OSError as error:
        raise _unwritable(path, error) from error
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
        raise _unwritable(path, PermissionError(errno.EACCES, "no right to write into its folder"))
    return target


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str], *, force: bool = False) -> Iterator[Path]:
    """Write a file beside its target, and give it the target's name once it is whole.

    Parameters
    ----------
    path : str or os.PathLike
        The file to write. A link stays, and the file that it points at is replaced.
    force : bool
        Whether a file that exists already may be replaced. Its permission bits are kept.

    Yields
    ------
    pathlib.Path
        A new, empty, hidden file in the folder of the target, with its suffix. Whatever ends the block early,
        an interrupt too, removes it and leaves the target as it was.

    Raises
    ------
    SuppleError
        As `check_output` does; when a file of that name has appeared meanwhile and `force` is false; and for
        every `OSError` of the block, such as a full disk.
    """
    target = check_output(path, force=force)
    # the end of the name keeps the suffixes, and a long name within what the file system takes
    temporary = target.with_name(f".{os.urandom(6).hex()}-{target.name[-40:]}")
    try:
        # created here: this tests the right to write, and takes the permission bits from the umask
        os.close(os.open(temporary, _NEW, 0o666))
        yield temporary
        with open(temporary, "rb+") as file:
            os.fsync(file.fileno())  # a late "disk full" belongs before the rename
        if not _publish(temporary, target, force):
            raise _exists(path)
    except OSError as error:
        # Libraries have other words for a full disk.
        limit = error.errno in (errno.EFBIG, errno.EDQUOT)
        raise _unwritable(path, _full() if not limit and _is_full(temporary.parent) else error, temporary) from error
    except SuppleError as error:
        if str(error).startswith("cannot write") and _is_full(temporary.parent):
            raise _unwritable(path, _full()) from error
        raise
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def _is_full(folder: Path) -> bool:
    """Return whether there is no space left on a disk, while what was written in vain is still there."""
    try:
        return shutil.disk_usage(folder).free < _SPARE
    except OSError:
        return False


def _full() -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _mode(path: Path) -> int | None:
    """Tell what kind of file stands there, if one does."""
    try:
        return os.lstat(path).st_mode
    except FileNotFoundError:
        return None


def _publish(temporary: Path, target: Path, force: bool) -> bool:
    """Give the finished file its name, unless it is taken and `force` is false; tell whether it was done."""
    if force:
        mode = _mode(target)
        if mode is not None:
            os.chmod(temporary, mode & 0o777)
        os.replace(temporary, target)
        return True
    try:
        os.link(temporary, target)  # one step, and it fails where the name is taken
    except OSError:  # so it is, or the file system has no links: reserve the name first
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


def _exists(path: str | os.PathLike[str]) -> SuppleError:
    return SuppleError(f"{shown(path)} exists already: pass --force (force=True) to replace it")


def _unwritable(path: str | os.PathLike[str], error: OSError, temporary: Path | None = None) -> SuppleError:
    """Say in one sentence why a file could not be written, and what would help."""
    reason = error.strerror or str(error) or type(error).__name__
    if temporary is not None and error.filename not in (None, temporary, str(temporary)):
        reason += f" ({shown(os.fsdecode(error.filename))})"  # another file's trouble
    advice = _ADVICE.get(error.errno or 0, "choose another place")
    return SuppleError(f"cannot write {shown(path)}: {reason}: {advice}")


def same_file(one: str | os.PathLike[str], other: str | os.PathLike[str]) -> bool:
    """Return whether two names are of one file that is there."""
    try:
        return os.path.samefile(one, other)
    except (OSError, ValueError):
        return False
