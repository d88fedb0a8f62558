"""Batches of pictures: finding inputs, naming outputs, and processing several at a time."""

from __future__ import annotations

import contextlib
import glob
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import NoReturn

from supple.cli.console import FAULT, REFUSED, STREAM, Console, deaf, outcome
from supple.cli.options import is_pattern
from supple.engine.memory import machine_memory
from supple.engine.progress import counted
from supple.errors import SuppleError, listing, shown
from supple.files.recipes import is_media_name
from supple.media.medium import ONE_FILE
from supple.media.pictures import SUFFIXES as PICTURES
from supple.media.suffixes import CLIPS, suffix_of

Job = tuple[Path, Path]
PathLike = str | os.PathLike[str]
_KNOWN = PICTURES | CLIPS | ONE_FILE


def pair(given: Sequence[str], target: str, *, recursive: bool = False) -> tuple[list[Job], bool, list[Path]]:
    """Find the input files, and name the output of each.

    ``given`` are files, folders and patterns; ``target`` is a file, or a folder if it exists as one, ends in a slash,
    or there may be several pictures. Return pairs of input and output, in order; whether the target is a folder; and
    the skipped folders, which were within a given folder or matched a pattern. With ``recursive``, folders are entered
    instead, and have the same names in the target.
    """
    left: list[Path] = []
    found: list[tuple[Path, Path]] = []  # (input, output relative to the target)
    several = len(given) > 1
    for name in given:
        path = Path(name)
        if os.path.isdir(name):
            several = True
            inside = list[Path]()
            for folder, names, files in os.walk(name, onerror=_unreadable, followlinks=True):
                seen = [Path(folder, file) for file in sorted(files) if file[0] != "." and suffix_of(file) in _KNOWN]
                inside += [path for path in seen if path.is_file()]  # neither pipes nor broken links
                below = [Path(folder, each) for each in sorted(names) if each[0] != "."]
                left += [] if recursive else below
                earlier = os.path.realpath(target)  # outputs of an earlier run, which are not inputs
                names[:] = [each.name for each in below if recursive and os.path.realpath(each) != earlier]
            if not inside:
                told = f"the folder {shown(name)} holds no pictures or DICOM slices"
                raise SuppleError(f"{told}: give another, or their names")
            found += [(p, p.relative_to(path)) for p in inside]
        elif is_pattern(name):
            several = True
            every = sorted(Path(p) for p in glob.glob(name, recursive=True))
            matching = [path for path in every if not os.path.isdir(path)]
            left += [path for path in every if os.path.isdir(path)] if "**" not in name else []
            if not matching:
                raise SuppleError(f"no file matches {shown(name)}: check the pattern")
            base = _fixed_part(name)
            found += [(p, p.relative_to(base)) for p in matching]
        else:
            found.append((path, Path(path.name)))
    if not several and not os.path.isdir(target) and not target.endswith(("/", os.sep)):
        return [(found[0][0], Path(target))], False, []
    if is_media_name(target) and not os.path.isdir(target):
        raise SuppleError(
            f"{shown(target)} is the name of one file, and several, a folder or a pattern become a folder: name one, "
            "such as bent/"
        )
    if STREAM in (*given, target):
        raise SuppleError("- stands for one file on standard input or output: give one to read, and one to write")
    jobs = [(source, Path(target) / name) for source, name in found]
    taken: dict[Path, Path] = {}
    for source, goal in jobs:
        if taken.setdefault(goal, source) != source:
            raise SuppleError(f"{shown(taken[goal])} and {shown(source)} would both become {shown(goal)}")
    sources = {os.path.realpath(source) for source, _ in jobs}
    for source, goal in jobs:
        if os.path.realpath(goal) in sources - {os.path.realpath(source)}:
            raise SuppleError(
                f"{shown(source)} would become {shown(goal)}, which is to be read too: use another folder"
            )
    return list(dict.fromkeys(jobs)), True, left


def _unreadable(error: OSError) -> NoReturn:
    raise SuppleError(f"cannot read the folder {shown(error.filename)}: {error.strerror}: check its rights") from error


def summary(jobs: Sequence[Job], failed: Collection[Path], there: int, target: str, left: Sequence[Path]) -> str:
    """Return a summary of several files in one line; ``there`` existed already, and ``left`` are skipped folders."""
    count = len(jobs)
    done = f"{count - len(failed)} of {count} files" if failed else f"{count} file{'s' * (count != 1)}"
    kept = f", {there} there already" if there else ""
    named, folders = (listing([shown(path) for path in paths], 5) for paths in (sorted(failed), left))
    lost = f", {len(failed)} failed: {named}" if failed else ""
    entered = f"; folders that were not entered: {folders} (--recursive enters them)" if left else ""
    return f"{done} written into {shown(target)}{kept}{lost}{entered}"


def make_folders(jobs: Sequence[Job]) -> None:
    """Create the folders of the targets."""
    for folder in dict.fromkeys(target.parent for _, target in jobs):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SuppleError(
                f"cannot make the folder {shown(folder)}: {error.strerror}: choose another place"
            ) from error


@contextlib.contextmanager
def piped(job: tuple[PathLike, PathLike], console: Console, otherwise: str = "") -> Iterator[tuple[PathLike, PathLike]]:
    """Yield a job with temporary files in place of standard input and output, which are named by a dash.

    Standard output gets the source's format, and is written when the file is complete. Input of an unknown format gets
    the suffix ``otherwise``.
    """
    source, target = job
    if STREAM not in (str(source), str(target)):
        yield job
        return
    with tempfile.TemporaryDirectory(prefix="supple-") as folder:
        place = Path(folder)
        if str(source) == STREAM:
            if sys.stdin is None:
                raise SuppleError("standard input is closed: name a file to read")
            begin = sys.stdin.buffer.read(512)
            source = place / f"input{_suffix_by_content(begin) or otherwise}"
            console.names[str(source)] = "standard input"
            with open(source, "wb") as file:
                file.write(begin)
                shutil.copyfileobj(sys.stdin.buffer, file)
        if str(target) == STREAM:
            if sys.stdout is None:
                raise SuppleError("standard output is closed: name a file to write")
            target = place / f"output{_suffix_like(Path(source))}"
            console.names[str(target)] = "standard output"
        yield source, target
        if str(job[1]) == STREAM:
            with open(target, "rb") as file:
                shutil.copyfileobj(file, sys.stdout.buffer)
            sys.stdout.buffer.flush()


def _suffix_by_content(begin: bytes) -> str:
    """Return the suffix for the first bytes of a file, for formats that are read by suffix; empty for pictures."""
    brand = begin[8:12]
    if begin[4:8] == b"ftyp" and brand not in (b"avif", b"avis", b"heic", b"heix", b"mif1", b"msf1"):
        return ".mov" if brand == b"qt  " else ".mp4"
    known = {
        b"\x1a\x45\xdf\xa3": ".webm" if b"webm" in begin else ".mkv",
        b"\x1f\x8b": ".nii.gz",
        b"NRRD": ".nrrd",
        b"ObjectType": ".mha",
        b"# Markups": ".fcsv",
        b"{": ".mrk.json",
    }
    for magic, suffix in known.items():
        if begin.startswith(magic):
            return suffix
    if begin[344:348] == b"n+1\0":
        return ".nii"
    return ".avi" if begin[:4] == b"RIFF" and begin[8:12] == b"AVI " else ""


def _suffix_like(source: Path) -> str:
    """Return the suffix of a file, or, if its name has none, that of its image format."""
    if source.suffix:
        return suffix_of(source)
    from supple.media.image import info
    from supple.media.pictures import OUT

    found = info(source)["format"]
    if suffix := next((suffix for suffix, form in OUT.items() if form.name == found), ""):
        return suffix
    raise SuppleError(f"cannot write standard output: {found} is not written: name a file, out.png for instance")


def _fixed_part(pattern: str) -> Path:
    parts = []
    for part in Path(pattern).parts[:-1]:
        if glob.has_magic(part):
            break
        parts.append(part)
    return Path(*parts)


class _StoppedError(Exception):
    pass


class Crew:
    """A pool of threads that process several pictures at once, limited by cores and memory.

    An interrupt stops all jobs, except for those that are writing: these are finished, so that no temporary files
    remain.
    """

    def __init__(self, workers: int, memory: float | None = None) -> None:
        self._workers = workers
        self._free = self._memory = machine_memory() / 2 if memory is None else memory
        self._writing = 0
        self._stopped = False
        self._changed = threading.Condition()

    def work(
        self,
        jobs: Sequence[Job],
        do: Callable[[Job, Callable[[str], None]], None],
        console: Console,
        failed: Callable[[Job, str], None],
    ) -> int:
        """Do all jobs; report those that fail, and go on with the others; return the exit status."""
        status = 0
        pool = ThreadPoolExecutor(self._workers, "supple-file")
        try:
            with counted(console.terminal, "files") as tell:
                tell("warp", 0, len(jobs))
                futures = {pool.submit(self._one, job, do): job for job in jobs}
                for done, future in enumerate(_ended(futures), 1):
                    error = future.exception()
                    if error is not None and (not isinstance(error, Exception) or isinstance(error, BrokenPipeError)):
                        raise error  # interrupts, and BrokenPipeError if the reader of the output is gone
                    if error is not None:
                        message, blame = outcome(error)
                        source, target = map(shown, futures[future])
                        if source not in message and target not in message:
                            message = f"{source}: {message}"
                        status = FAULT if FAULT in (status, blame) else REFUSED
                        console.say(message)
                        failed(futures[future], message)
                    tell("warp", done, len(jobs))
        except BaseException:
            with deaf():
                self._stop()
                pool.shutdown(wait=False, cancel_futures=True)
            raise
        pool.shutdown()
        return status

    def _one(self, job: Job, do: Callable[[Job, Callable[[str], None]], None]) -> None:
        writing = False

        def step(name: str) -> None:
            nonlocal writing
            with self._changed:
                if self._stopped:
                    raise _StoppedError
                if name == "write":
                    writing = True
                    self._writing += 1

        need = min(_size(job[0]), self._memory)
        with self._changed:
            self._changed.wait_for(lambda: self._free >= need or self._stopped)
            self._free -= need
        try:
            do(job, step)
        finally:
            with self._changed:
                self._free += need
                self._writing -= writing
                self._changed.notify_all()

    def _stop(self) -> None:
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._writing)


def _ended(futures: Iterable[Future[None]]) -> Iterator[Future[None]]:
    """Yield futures as they end; it polls, since a signal that another thread receives does not end a wait."""
    waiting = set(futures)
    while waiting:
        ended, waiting = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
        yield from ended


def _size(path: Path) -> float:
    """Return an estimate of the bytes of memory for a picture, twice its pixels; 0 if it cannot be read."""
    from supple.media.image import info

    try:
        facts = info(path)
    except SuppleError:
        return 0.0
    width, height, channels = (float(str(facts[name])) for name in ("width", "height", "channels"))
    return 2.0 * width * height * channels * max(1, int(str(facts["bits"])) // 8)
