"""The command as a process: interrupts, full disks, output that nobody reads."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from supple.cli import console
from supple.cli.console import Console
from supple.cli.jobs import Crew, Job
from supple.media import image
from tests.children import start, watched
from tests.cli.commands import GRAB, Said, noise, one_line, pictures


def finish(process: subprocess.Popen[str]) -> Said:
    out, err = process.communicate(timeout=300)
    return process.returncode, out or "", err


def test_a_process_ends_as_it_should(here: Path) -> None:
    assert finish(start("warp", "in.png", "out.png", *GRAB, "--json"))[0] == 0
    status, out, err = finish(start("warp", "in.png", "out.png", *GRAB))
    assert (status, out) == (2, "")
    assert "--force" in one_line(err)


def when_it_writes(process: subprocess.Popen[str], folder: str, number: int) -> None:
    end = time.monotonic() + 200
    while not any(p.name.startswith(".") and p.stat().st_size for p in Path(folder).iterdir()):
        assert process.poll() is None
        assert time.monotonic() < end
        time.sleep(0.002)
    process.send_signal(number)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupt_in_mid_write_leaves_nothing(here: Path, number: int, status: int) -> None:
    image.write("big.tif", noise(2400, 2000))
    Path("out").mkdir()
    process = start("warp", "big.tif", "out/big.png", *GRAB)
    when_it_writes(process, "out", number)
    ended, out, err = finish(process)
    assert (ended, out) == (status, "")
    one_line(err)
    assert os.listdir("out") == []


def test_an_interrupt_of_an_import_is_one_line() -> None:
    code = (
        "import builtins, supple.__main__\n"
        "real = builtins.__import__\n"
        "def interrupted(name, *rest):\n"
        "    if name.startswith('cyclopts'):\n"
        "        raise KeyboardInterrupt\n"
        "    return real(name, *rest)\n"
        "builtins.__import__ = interrupted\n"
        "supple.__main__.main()\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "supple: interrupted\n")


def test_an_interrupt_among_many_leaves_whole_files(here: Path) -> None:
    os.mkdir("in")
    for i in range(6):
        image.write(f"in/{i}.tif", noise(1200, 1000))
    os.mkdir("out")
    process = start("warp", "in/*.tif", "out", *GRAB)
    when_it_writes(process, "out", signal.SIGINT)
    ended, out, err = finish(process)
    assert (ended, out) == (130, "")
    one_line(err)
    done = os.listdir("out")
    assert len(done) < 6
    for name in done:
        assert image.read(f"out/{name}").pixels.shape == (1200, 1000, 3)


def test_output_that_nobody_reads_is_no_error(here: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        status, _, err = finish(start("info", "in.png", stdout=writing))
    finally:
        os.close(writing)
    assert (status, err) == (141, "")


def test_output_that_finds_no_room_is_one_line(here: Path) -> None:
    with open("/dev/full", "w") as full:
        status, _, err = finish(start("info", "in.png", stdout=full))
    assert status == 2
    one_line(err)


def test_progress_is_for_terminals(here: Path) -> None:
    pictures("in")
    status, shown = watched("warp", "in", "out", *GRAB)
    assert status == 2
    assert "3/3" in shown
    assert "supple: cannot read in/bad.png" in shown


def test_an_interrupt_that_another_thread_is_given_is_heard(capsys: pytest.CaptureFixture[str]) -> None:
    given = []

    def work(job: Job, step: Callable[[str], None]) -> None:
        time.sleep(0.5)  # until it is waited for
        given.append(time.monotonic())
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)  # as systems do now and then
        while time.monotonic() < given[0] + 30:
            step("read")  # raises once all is stopped
            time.sleep(0.01)

    def warp(console: Console) -> None:
        Crew(1).work([(Path("in.png"), Path("out.png"))], work, console, lambda job, message: None)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert console.run(warp) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.monotonic() - given[0] < 10
    assert capsys.readouterr() == ("", "supple: interrupted\n")


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupt_is_not_lost_where_c_calls_python(number: signal.Signals, status: int) -> None:
    """What a function raises that C has called goes no further: ctypes and cffi only write it down."""

    def work(console: Console) -> None:
        ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(number))()
        time.sleep(10)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    begun = time.monotonic()
    try:
        assert console.run(work) == status
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.monotonic() - begun < 9
