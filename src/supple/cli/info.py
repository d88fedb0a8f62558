"""The command that describes files."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from supple.cli.console import REFUSED, STREAM, File, SomeFailedError, about, current, one_line
from supple.cli.options import VolumeArguments
from supple.errors import SuppleError


def info(
    *files: Annotated[str, Parameter(name="FILE")],
    gpu: bool = False,
    json: bool = False,
    volume: VolumeArguments = VolumeArguments(),
) -> None:
    """Describe pictures, videos, volumes, Zarr stores and recipes, or list the GPUs.

    Parameters
    ----------
    files
        Pictures, videos, image sequences (a pattern or a folder), volumes, Zarr arrays and OME-Zarr
        images, or recipes in JSON.
    gpu
        List the GPUs, software ones too. The first is the one that is used.
    json
        Print one JSON object for each file.
    """
    console = current()
    from supple.cli.describe import describe
    from supple.cli.jobs import piped

    if not gpu and not files:
        raise SuppleError("give a file to tell about: supple info FILE, or supple info --gpu")
    if gpu:
        from supple.gpu.device import describe as describe_gpus

        for found in describe_gpus():
            if json:
                console.tell(found)
            else:
                print(f"{found['name']}: {found['kind']}, {found['backend']}, {found['driver']}")
    failures, reading = 0, volume.to_reading(strokes=False)
    for name in files:
        with about(File(name, named=len(files) > 1)):
            try:
                with piped((name, ""), console) as (path, _):
                    reading.check(path)
                    facts, text = describe(str(path), reading.how)
                if name == STREAM:
                    facts, text = {**facts, "file": "-"}, text.replace(str(path), "standard input")
            except SuppleError as error:
                failures = REFUSED
                console.say(error)
                facts, text = {"file": "-" if name == STREAM else name, "error": one_line(error)}, ""
            if json:
                console.tell(facts)
        if text and not json:
            print(text)
    if failures:
        raise SomeFailedError(failures)
