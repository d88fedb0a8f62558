"""How kernels share the cores."""

from __future__ import annotations

import threading
import time

import pytest

from supple.cpu.kernel import share


@pytest.fixture(autouse=True)
def two_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUPPLE_THREADS", "2")


def _worker(k: int) -> tuple[int, int]:
    time.sleep(0.005)
    return k, threading.get_ident()


@pytest.mark.parametrize("brief", [False, True])
def test_results_are_in_order_from_two_threads(brief: bool) -> None:
    found = share(_worker, range(20), brief=brief)
    assert [k for k, _ in found] == list(range(20))
    workers = {thread for _, thread in found}
    assert len(workers) == 2
    assert (threading.get_ident() in workers) == brief


@pytest.mark.parametrize("brief", [False, True])
def test_what_fails_ends_all_and_leaves_nothing_behind(brief: bool) -> None:
    begun = []

    def fail(k: int) -> None:
        begun.append(k)
        time.sleep(0.005)
        if k == 3:
            raise ValueError("the fourth")

    with pytest.raises(ValueError, match="the fourth"):
        share(fail, range(100), brief=brief)
    assert len(begun) < 10
    assert len({thread for _, thread in share(_worker, range(20), brief=brief)}) == 2


def test_an_interrupt_of_the_caller_s_own_work_ends_it() -> None:
    caller = threading.get_ident()

    def interrupted(k: int) -> None:
        time.sleep(0.005)
        if threading.get_ident() == caller:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        share(interrupted, range(100), brief=True)
    assert caller in {thread for _, thread in share(_worker, range(20), brief=True)}


@pytest.mark.parametrize("brief", [False, True])
def test_within_shared_work_all_is_done_there(brief: bool) -> None:
    def inner(k: int) -> set[int]:
        return {thread for _, thread in share(_worker, range(3), brief=brief)} | {threading.get_ident()}

    assert all(len(threads) == 1 for threads in share(inner, range(6), brief=brief))
