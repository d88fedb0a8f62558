"""Running the tasks of a job: on threads of this process, or, by Dask, on local processes or a cluster."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any, TypeVar

from supple._core import threads
from supple.engine.work import Tell
from supple.errors import SuppleError, need, said, shown
from supple.files.options import Running
from supple.media.stores.places import Place

Job = TypeVar("Job")
Item = TypeVar("Item")
Result = TypeVar("Result")
Advance = Callable[[], None]

_PATIENCE = 10  # seconds to wait for a scheduler's answer


class Runner:
    """A runner of tasks on threads of this process."""

    @property
    def slots(self) -> int:
        """The number of tasks that run at a time."""
        return threads()

    def each(
        self, function: Callable[[Job, Item], Result], job: Job, items: Sequence[Item], advance: Advance
    ) -> list[Result]:
        """Return ``function(job, item)`` for each item, in order; ``advance`` is called whenever one is done."""
        pool = ThreadPoolExecutor(self.slots)
        try:
            futures = [pool.submit(function, job, item) for item in items]
            for future in as_completed(futures):
                future.result()  # which raises its error
                advance()
            return [future.result() for future in futures]
        finally:
            pool.shutdown(cancel_futures=True)  # after an error, no further task writes


def advancing(tell: Tell, step: str, total: int) -> Advance:
    """Return a function that counts one finished task of a step with each call, and reports it to ``tell``."""
    ready = itertools.count(1)
    tell(step, 0, total)
    return lambda: tell(step, next(ready), total)


@contextlib.contextmanager
def runner_of(running: Running) -> Iterator[Runner]:
    """Yield a runner for the tasks of a job; SuppleError if Dask is not installed, or the scheduler does not answer."""
    need("zarr", "outputs that are written block by block", "dask")
    if not running.elsewhere:
        yield Runner()
        return
    need("zarr", "workers", "distributed")
    where = _processes(running.workers or 1) if running.scheduler is None else _cluster(running.scheduler)
    with _quiet(), where as runner:
        yield runner


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silence Dask's log messages; its errors are converted to one sentence."""
    _distributed()  # imported first, as it sets log levels
    loggers = [logging.getLogger(name) for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    before = [one.level for one in loggers]
    for one in loggers:
        one.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for one, level in zip(loggers, before, strict=True):
            one.setLevel(level)


class _Distributed(Runner):
    """A runner of tasks on Dask workers, local processes or a cluster."""

    def __init__(self, client: Any, told: str) -> None:
        self._client, self._told = client, told
        self._held: dict[int, tuple[object, Any]] = {}

    @property
    def slots(self) -> int:
        return max(1, int(sum(self._client.nthreads().values())))

    def each(
        self, function: Callable[[Job, Item], Result], job: Job, items: Sequence[Item], advance: Advance
    ) -> list[Result]:
        futures: list[Any] = []
        with self._failing():
            try:
                if id(job) not in self._held:
                    # submitted as a task, not as data, so that it is repeated if its worker is lost
                    self._held[id(job)] = job, self._client.submit(pickle.loads, pickle.dumps(job), pure=False)
                held = [self._held[id(job)][1]] * len(items)
                futures = self._client.map(function, held, list(items), pure=False)
                for future in _distributed().as_completed(futures):
                    if future.status != "finished":
                        future.result()  # which raises its error
                    advance()
                return list(self._client.gather(futures))
            except BaseException:
                with contextlib.suppress(Exception):
                    self._client.cancel(futures, force=True)
                raise

    @contextlib.contextmanager
    def _failing(self) -> Iterator[None]:
        """Convert errors of the cluster to one sentence; SuppleErrors of tasks pass unchanged."""
        from asyncio import CancelledError
        from concurrent.futures import CancelledError as Cancelled

        try:
            yield
        except SuppleError:
            raise
        except _distributed().KilledWorker as error:
            text = f"{self._told} ended again and again at the same block, as they do when their memory is full: give"
            raise SuppleError(f"{text} fewer workers, or workers with more memory; the same command goes on") from error
        except (ImportError, AttributeError) as error:
            text = f"{self._told} cannot do this ({said(error)}): install the same versions of Supple and of its"
            raise SuppleError(f"{text} packages there") from error
        except (CancelledError, Cancelled, OSError) as error:
            why = said(error) if isinstance(error, OSError) else "their scheduler ended"
            raise SuppleError(f"{self._told} were lost ({why}): start them again; the same command goes on") from error


@contextlib.contextmanager
def _processes(count: int) -> Iterator[Runner]:
    # Each process has its share of the cores, for parallel tasks, since a chunk is decoded by one thread.
    share = max(1, round(threads() / count))
    with _ignored():
        try:
            cluster = _distributed().LocalCluster(
                n_workers=count, threads_per_worker=share, processes=True, dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL, env={"SUPPLE_THREADS": str(share)}, preload=[__name__],
            )  # fmt: skip
        except (OSError, RuntimeError) as error:
            raise SuppleError(
                f"{count} processes do not start ({said(error)}): give fewer workers; and in a script, call this "
                'under if __name__ == "__main__":, since they import it'
            ) from error
    with _closing(cluster), _closing(_distributed().Client(cluster, timeout=_PATIENCE)) as client:
        yield _Distributed(client, "the processes that work")


@contextlib.contextmanager
def _closing(opened: Any) -> Iterator[Any]:
    try:
        yield opened
    finally:
        with contextlib.suppress(Exception):
            opened.close(timeout=_PATIENCE)


@contextlib.contextmanager
def _ignored() -> Iterator[None]:
    """Let processes started here ignore interrupts: a terminal sends these to all, and this process ends the others."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited by child processes
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def dask_setup(worker: object) -> None:
    """Ignore interrupts in a restarted worker process; Dask calls this function by its name."""
    with contextlib.suppress(ValueError):  # raised outside the main thread
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextlib.contextmanager
def _cluster(address: str) -> Iterator[Runner]:
    try:
        client = _distributed().Client(address, timeout=_PATIENCE)
    except (OSError, ValueError, TypeError, ImportError) as error:
        text = f"the scheduler {address} does not answer ({said(error)}): check the address, as tcp://HOST:8786, and"
        raise SuppleError(f"{text} that it runs") from error
    with _closing(client):
        if not client.nthreads():
            raise SuppleError(f"the scheduler {address} has no workers: start some (dask worker {address})")
        yield _Distributed(client, f"the workers of {address}")


def check_shared(addresses: Sequence[str | os.PathLike[str]]) -> None:
    """Raise SuppleError for stores that other processes cannot access, as in ``memory://``."""
    for address in addresses:
        if os.fspath(address).partition("://")[0].lower() == "memory":
            raise SuppleError(
                f"{os.fspath(address)} is in the memory of this process, which workers do not see: name a folder or a "
                "bucket"
            )


def check_seen(*places: Place) -> None:
    """Raise SuppleError if this worker cannot see a folder or a file; Zarr would read fill values instead."""
    for place in places:
        if place.folder is not None and not place.folder.exists():
            text = f"{shown(place.address)} is gone, or a worker does not see it: give addresses that all workers reach"
            raise SuppleError(f"{text}, and start them where these are")


def _distributed() -> Any:
    """Return the module dask.distributed, imported at the first use."""
    import distributed

    return distributed
