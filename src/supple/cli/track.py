"""The command that tracks points through a clip."""

from __future__ import annotations

import os
from typing import Annotated, Any

from cyclopts import Parameter

from supple.cli.options import (
    RUNNING,
    VIDEO,
    Frames,
    RunOptions,
    Texts,
    parse_first,
    parse_memory,
    parse_number,
    read,
    text,
)
from supple.errors import SuppleError, counting


def track(
    source: Annotated[str, Parameter(name="IN")],
    target: Annotated[str, Parameter(name="OUT")],
    /,
    *,
    at: Annotated[Texts, text("X,Y,K")] = (),
    first_frame: Annotated[Any, read(parse_first, "N|files", group=VIDEO)] = None,
    memory: Annotated[float | None, read(parse_memory, "GB", group=RUNNING)] = None,
    options: RunOptions = RunOptions(),
) -> None:
    """Track points through a video, for --track of supple warp.

    Each point is followed to the last and to the first frame, or to where it is lost, which is said. The table has the
    frames in which it was seen, and the distance in pixels between the ways forwards and backwards (error).

    Parameters
    ----------
    source
        A video, a pattern or a folder of pictures.
    target
        The table to write: a .csv with the columns frame, x, y, error and, of several points, name (1, 2, …).
    at
        A point that is seen in frame K, counted from 0, or at its timecode: a corner or a spot. Give it again for each
        further point.
    first_frame
        Number of the first frame, for --at, the table and messages, or files: as in the name of the first picture.
    memory
        Memory for frames on the way to the first one, in gigabytes (default 2).
    """
    console = options.start(source)
    from supple.engine.progress import counted
    from supple.files.options import GB
    from supple.files.tracking import track, write_track
    from supple.media.files import check_output, check_suffix

    if not at:
        raise SuppleError("give a point to track, and the frame in which it is seen: --at X,Y,K")
    typed = Frames(source, first_frame)
    points, first = [_point(text, typed) for text in at], typed.first or 0
    check_suffix(target, os.path.splitext(target)[1], (".csv", ".txt"), "is not that of a table", "name a .csv or .txt")
    check_output(target, force=options.force)
    with counted(console.terminal) as tell, counting(first):
        tracks = track(source, points, memory=2 * GB if memory is None else memory, tell=tell)
    write_track(target, tracks, force=options.force, first=first)
    if options.json:
        facts = [
            {
                "at": [*place, first + k],
                "first": first + int(each.frames[0]),
                "last": first + int(each.frames[-1]),
                "error": float(each.errors.max()),
                "lost": [{"frame": first + frame, "why": why} for frame, why in each.lost],
            }
            for (*place, k), each in zip(points, tracks, strict=True)
        ]
        console.tell({"input": source, "output": target, "points": facts})


def _point(text: str, frames: Frames) -> tuple[float, float, int]:
    wanted = "X,Y,K, a point in pixels and the frame in which it is seen"
    parts = text.split(",")
    if len(parts) != 3:
        raise SuppleError(f"--at must be {wanted}, found {text!r}")
    x, y = (parse_number("--at", part, wanted, typed=text) for part in parts[:2])
    return x, y, frames.read("--at", parts[2])
