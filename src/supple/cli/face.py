"""The command that adjusts faces."""

from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from supple.cli.options import RunOptions, SeveralOptions, WritingOptions, options_of, parse_percent, read, whole
from supple.cli.options_maps import Maps
from supple.cli.options_strokes import Edits, Landmarks, StrokeOptions
from supple.cli.warp import warp
from supple.errors import SuppleError

if TYPE_CHECKING:
    from supple.files.places import Places

FACES = Group("Faces", sort_key=1)
_percent = partial(parse_percent, wanted="percent from -100 to 100", low=-100, high=100)
_PERCENT = partial(read, _percent, "PERCENT", show_default=False)


@options_of(FACES)
class FaceOptions:
    """How faces are adjusted.

    Parameters
    ----------
    slim
        Make the face slimmer, from the cheeks to the chin: at 100, by half of its width.
    eyes
        Make the eyes larger by so many percent.
    smile
        Raise the corners of the mouth, by percent of half its width.
    nose
        Make the nose wider by so many percent; below 0, narrower.
    jaw
        Make the jaw wider: at 100, by half of its width; below 0, narrower.
    face
        Which face, 1 for the largest (default: all of them).
    """

    slim: Annotated[float, _PERCENT()] = 0.0
    eyes: Annotated[float, _PERCENT()] = 0.0
    smile: Annotated[float, _PERCENT()] = 0.0
    nose: Annotated[float, _PERCENT()] = 0.0
    jaw: Annotated[float, _PERCENT()] = 0.0
    landmarks: Landmarks = None
    face: Annotated[int | None, whole()] = None


class _Strokes(StrokeOptions):
    """The strokes that adjust the faces of each picture."""

    def __init__(self, options: FaceOptions) -> None:
        super().__init__(landmarks=options.landmarks)
        self._options = options

    def edits_in(self, places: "Places", *_: Any, **__: Any) -> Edits:
        from supple.files.faces import ADJUSTMENTS, face_stroke
        from supple.strokes import Recipe, Stroke

        percents = {name: getattr(self._options, name) for name in ADJUSTMENTS}
        if not any(percents.values()):
            raise SuppleError("nothing to do: give --slim, --eyes, --smile, --nose or --jaw, in percent")
        if (face := self._options.face) is not None and face < 1:
            raise SuppleError(f"--face must be the number of a face, 1 for the largest, found {face}")
        places.used = True
        if places.medium is None:
            return Edits(Recipe(strokes=(Stroke.grab((0, 0), by=(1, 1), radius=1),)), Maps(), relative=True)
        faces, grid = places.chosen(self._options.face), places.medium.grid
        assert grid is not None
        strokes = [face_stroke(face, place=place, size=grid.sizes, **percents) for place, face in faces]
        return Edits(Recipe(strokes=tuple(strokes)), Maps(), relative=True)


def face(
    *paths: Annotated[str, Parameter(name="IN... OUT", required=True)],
    faces: FaceOptions = FaceOptions(),
    writing: WritingOptions = WritingOptions(),
    several: SeveralOptions = SeveralOptions(),
    options: RunOptions = RunOptions(),
) -> None:
    """Adjust the faces of pictures: slimmer, larger eyes, a smile, a narrower nose.

    Each face is moved by its own landmarks, in one stroke, and sampled once; the background stays. Several files, a
    folder or a pattern in quotes are written to a folder under the same names.

    Parameters
    ----------
    paths
        Pictures to read, and last the file or folder to write.
    """
    if len(paths) < 2:
        raise SuppleError("give a picture to read and a name to write to: supple face IN OUT --slim 20 …")
    warp(*paths, strokes=_Strokes(faces), writing=writing, several=several, options=options)
