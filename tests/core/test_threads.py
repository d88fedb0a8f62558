"""The pool of threads: with forks, with Python's own threads, when interrupted, and when the process ends."""

from __future__ import annotations

import os
import sys
import threading

import numpy as np
import pytest

from supple import Deformation
from tests.core.drawn import in_a_process
from tests.effort import EVERY

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and forks are POSIX's")

WORK = """
import os, signal, sys, threading, time
import numpy as np
from supple import Deformation, _core
signal.signal(signal.SIGINT, signal.default_int_handler)
def warped(size, count=1, filter="auto"):
    d = Deformation((size, size), border=20).grab((size / 2, size / 2), by=(size / 9, 5), radius=size / 5)
    source = np.random.default_rng(0).integers(0, 256, (size, size, 3)).astype(np.uint8)
    return d.warp(source, filter=filter)
"""


def test_a_fork_has_a_pool_of_its_own() -> None:
    """The child has none of the threads that its parent's pool had."""
    result = in_a_process(
        WORK
        + """
import warnings
warnings.simplefilter("ignore", DeprecationWarning)  # of forks where there are threads
before = warped(300).tobytes()
for _ in range(3):
    child = os.fork()
    if child == 0:
        same = warped(300).tobytes() == before and _core.threads() == 3
        os._exit(0 if same else 1)
    assert warped(300).tobytes() == before
    assert os.waitpid(child, 0)[1] == 0
print("done")
""",
        SUPPLE_THREADS="3",
    )
    assert (result.returncode, result.stdout.strip()) == (0, "done"), result.stderr


@pytest.mark.skipif(
    "libasan" in os.environ.get("LD_PRELOAD", ""),
    reason="AddressSanitizer's allocator stays locked in the child of a fork, where a thread was allocating",
)
def test_a_fork_while_threads_work_ends() -> None:
    """Threads of the parent that are on their way back to Python are not waited for in the child."""
    result = in_a_process(
        WORK
        + """
import warnings
warnings.simplefilter("ignore", DeprecationWarning)
d = Deformation((64, 64)).grab((32, 32), by=(5, 3), radius=9)
image = np.zeros((64, 64), np.uint8)
def work():
    while True:
        d.warp(image)
for _ in range(2):
    threading.Thread(target=work, daemon=True).start()
for _ in range(10):
    child = os.fork()
    if child == 0:
        sys.exit(0)
    deadline = time.monotonic() + 30
    while os.waitpid(child, os.WNOHANG)[0] == 0:
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            sys.exit("a child hangs")
        time.sleep(0.002)
print("done", flush=True)
"""
    )
    assert (result.returncode, result.stdout.strip()) == (0, "done"), result.stderr


def test_two_threads_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUPPLE_THREADS", "3")
    d = Deformation((200, 240), border=20, on_fold="damp").grab((120, 90), by=(20, 9), radius=40, reach=None)
    source = np.random.default_rng(0).integers(0, 256, (200, 240, 3)).astype(np.uint8)
    expected, q = d.warp(source), np.random.default_rng(1).uniform(0, 200, (5000, 2))
    solved, wrong = d.inverse(q).points, []
    start = threading.Barrier(4)

    def again() -> None:
        start.wait()
        for _ in range(6):
            if not np.array_equal(d.warp(source), expected) or not np.array_equal(d.inverse(q).points, solved):
                wrong.append(threading.get_ident())  # noqa: PERF401

    several = [threading.Thread(target=again) for _ in range(4)]
    for thread in several:
        thread.start()
    for thread in several:
        thread.join(60)
        assert not thread.is_alive()
    assert not wrong


LONG = {
    "points": """
from supple._core.rows import numbers
d = Deformation((500, 500)).grab((250, 250), by=(40, 5), radius=90)
q = np.random.default_rng(0).uniform(0, 500, (200_000, 2))
rows = np.repeat(numbers(d.space.table), 400, axis=0)
rows[:, 3:6] /= 400
targets = np.zeros((400_000, 3)); targets[:, :2] = q.repeat(2, 0)
call = lambda: _core.inverse(_core.Map(rows, d.space.axes, 2), targets, 1e-9)
""",
    "a plan": """
d = Deformation((9000, 200), border=1.0)
d = d.grab((100, 4500), by=(0.2, 1.5), radius=150)
call = lambda: [d.inverse_map(tolerance=1e-6) for _ in range(1000)]
""",
    "a warp": """
d = Deformation((60, 700, 700)).grab((350, 350, 30), by=(40, 5, 4), radius=90)
source = np.zeros((60, 700, 700, 3), np.float64)
call = lambda: d.warp(source, between="cubic", time_filter=True)
""",
}


@pytest.mark.parametrize("threads", ["1", "3"])
@pytest.mark.parametrize("kind", LONG)
def test_an_interrupt_ends_work_soon(kind: str, threads: str) -> None:
    """With KeyboardInterrupt, as in Python; and then all works as before."""
    result = in_a_process(
        WORK
        + LONG[kind]
        + """
before = warped(100).tobytes()
sent = []
def send():
    sent.append(time.monotonic())
    os.kill(os.getpid(), signal.SIGINT)
timer = threading.Timer(0.5, send)
timer.start()
try:
    call()
except KeyboardInterrupt:
    took = time.monotonic() - sent[0]
else:
    took = -1.0
timer.join()
assert warped(100).tobytes() == before
print(took)
""",
        SUPPLE_THREADS=threads,
    )
    assert result.returncode == 0, result.stderr
    took = float(result.stdout)
    assert took >= 0, "it was not interrupted, or over before"
    assert took < (10 if EVERY == 1 else 60)  # a moment, where other processes and sanitizers leave one


def test_an_interrupt_of_a_picture_of_a_volume() -> None:
    result = in_a_process(
        WORK
        + """
import numpy as np
from supple.render.scene import Scene
shape = (90, 90, 90)
d = Deformation(shape, border=None)
for k in range(20): d = d.grab((45, 45 + k, 45), by=(2, 1, 1), radius=20)
scene = Scene(np.random.default_rng(0).random(shape), deformation=d, mode="exact")
sent = []
def send():
    sent.append(time.monotonic())
    os.kill(os.getpid(), signal.SIGINT)
timer = threading.Timer(0.3, send)
timer.start()
try:
    for _ in range(200): scene.render()
except KeyboardInterrupt:
    print("interrupted", time.monotonic() - sent[0])
""",
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("interrupted")


@pytest.mark.parametrize("wait", [0.0, 0.11])
def test_the_process_ends_while_a_thread_works(wait: float) -> None:
    """A daemon's work is dropped; nothing hangs, and nothing aborts."""
    result = in_a_process(
        WORK
        + LONG["points"]
        + f"""
threading.Thread(target=lambda: [call() for _ in range(100)], daemon=True).start()
threading.Thread(target=lambda: [warped(200) for _ in range(10_000)], daemon=True).start()
time.sleep({wait})
print("done", flush=True)
""",
        timeout=60,
        SUPPLE_THREADS="3",
    )
    assert (result.returncode, result.stdout.strip()) == (0, "done"), result.stderr


def test_a_process_that_only_imports_has_no_threads() -> None:
    if not os.path.isdir("/proc/self/task"):
        pytest.skip("where tasks are listed in /proc")
    result = in_a_process(WORK + 'print(len(os.listdir("/proc/self/task")))')
    alone = in_a_process('import numpy, os; print(len(os.listdir("/proc/self/task")))')
    assert (result.returncode, result.stdout) == (0, alone.stdout), result.stderr
