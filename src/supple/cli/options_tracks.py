"""Options for strokes that follow tracked points."""

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from supple.cli.options import VIDEO, parse_integer, read
from supple.errors import SuppleError

if TYPE_CHECKING:
    from supple.strokes import Recipe


_whole = partial(parse_integer, wanted="a whole number")


@Parameter(name="*", group=VIDEO)
@dataclass(kw_only=True, eq=False, repr=False)
class TrackOptions:
    """Options for strokes that follow tracked points.

    Parameters
    ----------
    track
        Move the strokes of the command line, of points X,Y, along with tracked points: a table frame,x,y (CSV, with a
        column name for several tracks), a script of Nuke, or keyframes copied from After Effects.
    track_name
        Name of the track to follow: once for all strokes, or once for each, in order.
    track_frame
        Frame, counted from 0, in which the strokes are where --grab has them (default: the first of the track).
    track_from
        How a table without a header counts: pixels (from the centre of the top left one), nuke or ae.
    track_first
        Number that the track gives to the first frame of the clip, if not 0, or in Nuke 1: often 1001.
    """

    track: Annotated[str | None, Parameter(metavar="FILE")] = None
    track_name: Annotated[list[str], Parameter(metavar="NAME", allow_leading_hyphen=True, show_default=False)] = ()  # type: ignore[assignment]
    track_frame: Annotated[int | None, read(_whole, "K")] = None
    track_from: Annotated[
        Literal["pixels", "nuke", "ae"] | None, Parameter(metavar="pixels|nuke|ae", show_choices=False)
    ] = None
    track_first: Annotated[int | None, read(_whole, "N")] = None

    def followed(self, recipe: "Recipe", count: int, clip: str) -> "Recipe":
        """Return a recipe whose last ``count`` strokes, those of the command line, follow the tracks."""
        if self.track is None:
            for name in ("track_name", "track_frame", "track_from", "track_first"):
                if getattr(self, name) not in (None, (), []):
                    raise SuppleError(f"--{name.replace('_', '-')} is for a --track, and there is none: leave it out")
            return recipe
        if not count:
            raise SuppleError("--track moves strokes of the command line, and there are none: give a --grab")
        from supple.files.tracks import follow_tracks

        total = len(recipe.strokes)
        return follow_tracks(
            recipe,
            self.track,
            clip,
            names=self.track_name,
            frame=self.track_frame,
            strokes=range(total - count, total),
            convention=self.track_from,
            first=self.track_first,
        )
