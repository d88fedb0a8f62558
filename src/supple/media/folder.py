"""Many output files that appear all together, or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path

from supple.errors import SuppleError, shown
from supple.media.files import check_output


def check_outputs(paths: Iterable[Path], *, force: bool = False) -> None:
    """Refuse output files of one folder that cannot be written; the folder itself may be missing.

    Raises
    ------
    SuppleError
        As `supple.media.files.check_output` does.
    """
    for path in paths:
        if not os.path.lexists(path.parent):
            check_output(path.parent)
            return
        check_output(path, force=force)


@contextlib.contextmanager
def replacing_all(folder: Path, *, force: bool = False) -> Iterator[Path]:
    """Write files into a hidden folder, and give them their place in ``folder`` once all are whole.

    Parameters
    ----------
    folder : pathlib.Path
        Where they go. It is made if it is missing, in a folder that is not.
    force : bool
        Whether files that exist already may be replaced. Their permission bits are kept.

    Yields
    ------
    pathlib.Path
        A new, empty, hidden folder in ``folder``, or beside where that will be. Whatever ends the block early, an
        interrupt too, removes it and leaves everything as it was.

    Raises
    ------
    SuppleError
        If a file of the same name has appeared meanwhile and `force` is false; and for every `OSError`.
    """
    place = Path(os.path.realpath(folder))
    new = not os.path.lexists(place)
    token = f".{secrets.token_hex(6)}-{place.name[-40:]}"
    temporary = (place.parent if new else place) / token  # on the file system that they go to
    try:
        temporary.mkdir()
        yield temporary
        if new and not os.path.lexists(place):
            os.rename(temporary, place)
        else:
            _publish(temporary, place, folder, force)
    except OSError as error:
        reason = error.strerror or str(error) or type(error).__name__
        raise SuppleError(f"cannot write into {shown(folder)}: {reason}: choose another place") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _publish(temporary: Path, place: Path, folder: Path, force: bool) -> None:
    """Move every file to its place; where one cannot be moved, move all of them back."""
    backup = temporary / "replaced"
    names = sorted(os.listdir(temporary))
    backup.mkdir()
    moved: list[tuple[Path, Path]] = []
    try:
        for name in names:
            target = place / name
            if os.path.lexists(target):
                if not force:
                    raise SuppleError(f"{shown(folder / name)} exists already: pass --force (force=True) to replace it")
                mode = os.lstat(target).st_mode
                if stat.S_ISDIR(mode):
                    raise OSError(errno.EISDIR, f"{shown(folder / name)} is a folder")
                if stat.S_ISREG(mode):
                    os.chmod(temporary / name, mode & 0o777)
                moved.append((target, backup / name))  # noted first: an interrupt may come between
                os.rename(target, backup / name)
            moved.append((temporary / name, target))
            os.rename(temporary / name, target)
    except BaseException:
        for before, after in reversed(moved):
            # What was noted and not moved still stands where it stood.
            if not os.path.lexists(before):
                os.rename(after, before)
        raise
