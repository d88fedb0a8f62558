"""The command that tells what files hold."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from supple.console import REFUSED, SomeFailedError, current
from supple.errors import SuppleError
from supple.options_volume import VolumeOptions

_VOLUME = VolumeOptions()


def info(
    *files: Annotated[str, Parameter(name="FILE")],
    gpu: Annotated[bool, Parameter(negative=())] = False,
    json: Annotated[bool, Parameter(negative=())] = False,
    volume: VolumeOptions = _VOLUME,
) -> None:
    """Tell what pictures, videos, volumes and recipes hold, or which GPUs there are.

    Parameters
    ----------
    files
        Pictures, videos, patterns or folders of frames, volumes, or recipes in JSON.
    gpu
        Which graphics cards there are, and programs that stand in for them; the first one is used.
    json
        As one JSON object for each file.
    """
    console = current()
    from supple.describe import describe

    if not gpu and not files:
        raise SuppleError("give a file to tell about: supple info FILE, or supple info --gpu")
    if gpu:
        from supple.gpu.device import describe as describe_gpus

        for found in describe_gpus():
            if json:
                console.tell(found)
            else:
                print(f"{found['name']}: {found['kind']}, {found['backend']}, {found['driver']}")
    failures, reading = 0, volume.to_reading()
    for name in files:
        try:
            facts, text = describe(name, layout=reading.layout, series=reading.series)
        except SuppleError as error:
            failures = REFUSED
            console.say(error)
            facts, text = {"file": name, "error": str(error)}, ""
        if json:
            console.tell(facts)
        elif text:
            print(text)
    if failures:
        raise SomeFailedError(failures)
