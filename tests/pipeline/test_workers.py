"""How work is shared among threads."""

from __future__ import annotations

import threading
import time

import pytest

from supple.engines.workers import share, threads


@pytest.fixture(autouse=True)
def two_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SUPPLE_THREADS", "2")


def _worker(k: int) -> tuple[int, int]:
    time.sleep(0.005)
    return k, threading.get_ident()


def test_results_are_in_order_from_two_threads() -> None:
    found = share(_worker, range(20))
    assert [k for k, _ in found] == list(range(20))
    workers = {thread for _, thread in found}
    assert len(workers) == 2
    assert threading.get_ident() not in workers


def test_what_fails_ends_all_and_leaves_nothing_behind() -> None:
    begun = []

    def fail(k: int) -> None:
        begun.append(k)
        time.sleep(0.005)
        if k == 3:
            raise ValueError("the fourth")

    with pytest.raises(ValueError, match="the fourth"):
        share(fail, range(100))
    assert len(begun) < 10
    assert len({thread for _, thread in share(_worker, range(20))}) == 2


@pytest.mark.parametrize(("asked", "wanted"), [("3", 3), ("0", None), ("-1", None), ("many", None), ("", None)])
def test_how_many_threads_there_are(monkeypatch: pytest.MonkeyPatch, asked: str, wanted: int | None) -> None:
    monkeypatch.delenv("SUPPLE_THREADS")
    usual = threads()
    assert usual >= 1
    monkeypatch.setenv("SUPPLE_THREADS", asked)
    assert threads() == (wanted or usual)


def test_within_shared_work_all_is_done_there() -> None:
    def inner(k: int) -> set[int]:
        return {thread for _, thread in share(_worker, range(3))} | {threading.get_ident()}

    assert all(len(found) == 1 for found in share(inner, range(6)))
