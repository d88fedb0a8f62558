"""Options of Zarr stores: where their blocks are worked on."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

if TYPE_CHECKING:
    from supple.files.tasks import Running

STORES = Group("Zarr stores", sort_key=4.5)


@Parameter(name="*", group=STORES)
@dataclass(kw_only=True, eq=False, repr=False)
class WorkerOptions:
    """Options of outputs that are written block by block.

    Parameters
    ----------
    workers
        Work in so many processes on this machine, which share its cores (default: threads of one process).
    scheduler
        Work on a cluster of Dask, which has started already: the address of its scheduler.
    """

    workers: Annotated[int | None, Parameter(metavar="N", allow_leading_hyphen=True)] = None
    scheduler: Annotated[str | None, Parameter(metavar="tcp://HOST:PORT")] = None

    @property
    def given(self) -> str | None:
        """The name of an option that is given; None if none is."""
        names = {"--workers": self.workers, "--scheduler": self.scheduler}
        return next((name for name, value in names.items() if value is not None), None)

    def to_running(self) -> "Running":
        """Return the options as the library takes them."""
        from supple.files.tasks import Running

        return Running(workers=self.workers, scheduler=self.scheduler)
