"""What the command line cannot do is one line, before any work, and changes nothing."""

from __future__ import annotations

import os
import re
import shlex
from pathlib import Path

import pytest

import supple
from tests.cli.commands import GRAB, Run, one_line

WORDS = {
    "GRAB": "--grab 20,16:23,18 --radius 12",
    "TIMED": "--grab 30,20,3:33,22,8 --radius 10 --border none",
    "FLAT": "--grab 14,12:17,14 --radius 5",
    "DEEP": "--grab 14,12,4:16,13,5 --radius 3",
    "DRAG": "--grab 11,13,9:14,11,10.5 --radius 9 --border 8",
    "STROKE": "--grab 4,4,4:5,4,4 --radius 3",
    "LONG": "x" * 300,
}
# Options that are whole numbers, which Cyclopts would round.
WHOLE = {
    "warp in.mkv o.mkv": ("hold", "quality", "jobs", "threads", "workers", "track-first"),
    "view in.png": ("port",),
    "render in.nii o.png": ("smooth", "turntable", "time"),
    "plan in.zarr": ("threads",),
    "face in.png o.png --slim 5": ("face",),
}
# How command lines begin, how they go on, and what is said of them; … stands for other words.
REFUSED: dict[str, list[tuple[str, str]]] = {
    "warp in.png o.png GRAB": [
        ("--labels smoth", "--labels must be nearest or smooth, or stand alone, found 'smoth'"),
        ("--poisson 0.51", "0.5"),
        ("--poisson nan", "nan"),
        ("--scales 4", "1, 2 or 3"),
        ("--scales 1.5", "1, 2 or 3"),
        ("--reach 0.5", "reach must be a number of radii from 1"),
        ("--reach nan", "nan"),
        ("--reach far", "--reach must be a number of radii from 1, or none, found 'far'"),
        ("--reach 4 --reach none", "2 times"),
        ("--border-profile cubic", "cubic"),
        ("--border thin", "for each axis, found 'thin'"),
        ("--border 1,0", "each number of --border must be a number above 0 … found '1,0'"),
        ("--border -3", "--border must be … found '-3'"),
        ("--on-fold pray", "pray"),
        ("--filter magic", "magic"),
        ("--outside void", "void"),
        ("--fill red", "red"),
        ("--fill 1,2", "fill"),
        ("--tolerance 0", "tolerance"),
        ("--tolerance nan", "tolerance"),
        ("--quality 0", "quality"),
        ("--quality x", "quality"),
        ("--threads 0", "--threads"),
        ("--nope", "--nope"),
        ("--recipe none.json", "none.json"),
        ("--save-recipe missing/r.json", "missing"),
        ("--save-recipe o.png", "o.png"),
        ("--amount=230%", "--amount must be a part of the strokes, from -100% to 200%, or from -1 to 2, "),
        ("--amount=-1.5", "--amount must be a part of the strokes, from -100% to 200%, or from -1 to 2, "),
        ("--amount=nan", "--amount must be a part of the strokes, from -100% to 200%, or from -1 to 2, "),
        ("--amount=some", "--amount must be a part of the strokes, from -100% to 200%, or from -1 to 2, "),
        ("--time-filter", "--time-filter is for clips"),
        ("--memory 0", "--memory is for clips"),
        ("--codec h264 --crf 20", "--codec is for clips"),
        ("--fps 25", "--fps is for clips"),
        ("--labels", "--labels is for volumes"),
        ("--world", "--world is for volumes"),
        ("--fill 9", "--fill is the constant of --outside constant, and --outside is edge: give both"),
        ("--border 3 --border 3", "--border specified multiple times"),
        ("--freeze none.png", "none.png"),
        ("--freeze in.png", "in.png cannot be a freeze mask: it has colours"),
        (
            "--freeze square.png --twist 24,20:5",
            "the freeze mask square.png is of 20 x 20 samples, and what is deformed of 48 x",
        ),
        ("--freeze labels.png", "labels.png seems to hold labels"),
        ("--freeze labels.png:4", "labels.png holds no label 4: found 0, 1, 2"),
        ("--freeze clear.png", "parts of it are transparent"),
        (
            "--freeze labels.png:1",
            "--freeze labels.png:1 stands after all strokes, and holds none: give it before those that",
        ),
        (
            "--freeze none --twist 24,20:5",
            "--freeze none thaws what was frozen before it, and nothing was: leave it out",
        ),
        ("--strength 3", "--strength must be a part of the strokes, from -100% to 200%, or from -1 to 2, found '3'"),
        ("--strength 1 --strength 2", "--strength is given 2 times for one stroke: give it once, or once for each"),
        ("--freeze-width 9", "--freeze-width is for a freeze mask, and there is none"),
        ("--freeze square.png --freeze-width 0", "--freeze-width must be a number of pixels or millimetres above 0"),
        ("--freeze square.png --freeze-width 1", "--freeze-width must be at least 4 samples, found 1"),
        ("--freeze labels.png:x", "--freeze FILE:LABEL needs the number of a label (labels.png:3, say), found 'x'"),
        ("--crop 0,0,0,1,1,1", "--crop must be 4 numbers, as the input is a picture"),
        ("--crop a,0,1,1", "--crop must be X,Y,W,H for a picture"),
        ("--resample x", "--resample must be a spacing S"),
        ("--reference head.nii", "head.nii is a volume, and the grid of a picture"),
    ],
    "warp in.png o.png --radius 5": [
        ("--twist 1,2:30:0,0", "--twist must be X,Y[,T|Z]:ANGLE[:AXIS], a point, degrees, and of 3 numbers an axis"),
        ("--twist 1,2,3:30", "has a point of 3 numbers, and a point of a picture has 2 numbers, x and y"),
        ("--twist 1,2:30 --restore 1,2", "Restoring and smoothing are for Python"),
        ("--twist 1,2:half", "found '1,2:half'"),
        ("--twist 1,2:nan", "--twist 1,2:nan: angle must be a number of degrees from -3600 to 3600, found nan"),
        ("--scale 1,2:0", "--scale 1,2:0: factor must be a number from 0.01 to 100, found 0"),
        ("--scale 1,2:1.4:1,0", "--scale must be X,Y[,T|Z]:FACTOR, a point and a factor (256,256:1.4, say)"),
        ("--scale ''", "found ''"),
        ("--pinch 1,2:-1", "--pinch 1,2:-1: factor must be"),
        ("--pinch 1,2:0.5:0,0", "--pinch 1,2:0.5:0,0: axis must be a direction, with a number other than 0"),
        ("--pinch 1,2:0.5:0,0,1", "--pinch must be X,Y[,T|Z]:FACTOR[:AXIS], a point, a factor, and an axis"),
        ("--twist 1,2:30 --scales 2", "--scales is for a --grab, and there is none: leave it out"),
        ("--twist 1,2:30 --scale 1,2:1.1 --reach 4 --reach 4 --reach 4", "for 2 strokes"),
        ("--grab 1,2:3,4 --twist 1,2:9 --scales 2 --scales 2", "2 times for one grab"),
    ],
    "warp in.png o.png --radius 8": [
        ("--pull a.csv", "--pull must be FROM:TO, two files of points (before.csv:after.csv, say), found 'a.csv'"),
        ("--pull a.csv:", "--pull must be FROM:TO"),
        ("--pull a.csv:none.csv", "--pull a.csv:none.csv: cannot read none.csv"),
        ("--pull a.csv:other.csv", "a.csv and other.csv do not both have the point q"),
        ("--pull d.csv:few.csv", "d.csv has 2 points, and few.csv has 1: give as many in both"),
        ("--pull flat.fcsv:flat.fcsv", "cannot place flat.fcsv: it is in RAS, and only volumes have a place in"),
        ("--pull same.csv:same2.csv", "same.csv has two points at (12, 20), point 1 and point 2: leave one out"),
        ("--pull edge.csv:a.csv", "a pull (edge.csv:a.csv) of 2 handles with radius 8 cannot arrive: handle 1, at"),
    ],
    "warp in.png o.png": [
        ("", "--grab X,Y:X,Y"),
        ("--grab 1,2:3,4", "--radius"),
        ("--radius 5", "--grab"),
        ("--grab 1,2:3 --radius 5", "X,Y:X,Y"),
        ("--grab a,b:c,d --radius 5", "X,Y:X,Y"),
        ("--grab '1,2:3,4\n5' --radius 5", "X,Y:X,Y"),
        ("--grab nan,2:3,4 --radius 5", "nan"),
        ("--grab 1,2:inf,4 --radius 5", "inf"),
        ("--grab 1,2,3:4,5,6 --radius 5", "2 numbers"),
        ("--grab 1,2:3,4 --radius nan", "nan"),
        ("--grab 1,2:3,4 --radius inf", "inf"),
        ("--grab 1,2:3,4 --radius 0", "above 0"),
        ("--grab 1,2:3,4 --radius -5", "above 0"),
        ("--grab 1,2:3,4 --radius abc", "abc"),
        ("--grab 1,2:3,4 --radius 5 --radius 6", "2 times"),
        ("--twist 1,2:9 --radius 0", "--radius must be a number of … above 0, or a percentage, found '0'"),
        ("--scale 1,2:1.5", "--scale needs a --radius: how far it is felt"),
        ("--recipe x.json --reach 5", "--reach is for strokes, and there are none: give --grab"),
        ("--crop 0,0,9,9 --amount 50%", "--amount is for strokes, and there are none: give --grab, --twist,"),
        ("--scalee 1,2:1.5", "Unknown option: --scalee"),
        ("--field u.nii", "u.nii is for volumes, with 3 axes, and in.png is a picture"),
        ("--field flow.yml --reference flow.yml", "cannot read flow.yml: it is no image"),
        ("--field flow.yml --crop 40,0,9,9", "--crop must be within the grid of 48 x 40 samples"),
        ("--field flow.yml --resample 0", "--resample must be a spacing S above 0"),
        ("--field flow.yml --resample 1,2,3", "--resample must be one number or 2 of them"),
        ("--field flow.yml --resample 1e-9", "resample to 1e-09 makes no picture"),
        ("--field flow.yml --affine 1,0,x,0,1,0", "--affine must be 6 numbers (pictures) or 12"),
        ("--inverse", "--inverse is for the --field or --affine before it, and there is none"),
        ("--rotate 5 --border 20", "--border is for strokes, and there are none"),
        ("--mirror 20", "--mirror is for strokes, and there are none"),
        ("--push 9,9:20,9:4 --radius 6 --time-radius 3", "a push has none: leave it out"),
        ("--field flow.yml --reference small.png", "and small.png, on whose pixels the result is written"),
        ("--field flow.yml --field tiny.yml --inverse", "and tiny.yml, which takes what it makes, of 30 x"),
        ("--field flow.yml --inverse --inverse", "--field flow.yml has two --inverse"),
        ("--affine 1,0,2,1,0,2", "--affine 1,0,2,1,0,2: the affine map is singular"),
        ("--affine 1,0,2,0,1,-3 --convention itk", "--convention is for files, and --affine"),
        ("--affine flow.yml", "flow.yml holds a field, and --affine is for affine maps"),
        ("--affine 1,0,2", "--affine must be 6 numbers (pictures) or 12 (volumes)"),
        ("--field -", "--field - is not possible"),
        ("--field flow.yml --save-recipe r.json", "--save-recipe is for strokes alone"),
    ],
    "warp in.png o.jpg GRAB": [
        ("--lossless", "cannot write o.jpg without loss: JPEG always loses: write PNG, TIFF, WebP or AVIF"),
        ("--quality 101", "101"),
    ],
    "warp head.nii o.nii": [
        ("--field far-u.nii", "far-u.nii and head.nii do not overlap: from (-917, "),
        ("--field far-u.nii --inverse", "far-u.nii and head.nii do not overlap: from ("),
        ("--field u.nii --reference far-head.nii", "u.nii and far-head.nii do not overlap: from ("),
        ("--field far-u.nii --reference far-head.nii", "what far-u.nii leads to and head.nii do not overlap: from ("),
        ("--field flow.yml", "flow.yml is for pictures, with 2 axes, and head.nii is a volume"),
        ("--field u.nii --reference a.tfm", "a.tfm is no volume, and the grid of a volume is needed"),
        ("--field u.nii --reference folder", "folder is no volume, and the grid of a volume is need"),
        ("--field u.nii --reference empty.nii", "cannot read empty.nii: it is empty"),
        ("--field u.nii --reference gone.nii", "cannot read gone.nii: No such file"),
        ("--field u.nii --resample 1e-4", "resample to 0.0001 makes a volume of 180,000 x 160,000 x 140,000"),
        ("--field u.nii --crop 0,0,5,5", "--crop must be 6 numbers, as the input is a volume"),
        ("--affine 1,0,2,0,1,-3", "--affine 1,0,2,0,1,-3 is for pictures, with 2 axes, and head.nii"),
        ("--reference in.png", "in.png is a picture, and the grid of a volume is needed"),
        ("--reference clip.mp4", "clip.mp4 is a clip, and the grid of a volume is needed"),
    ],
    "warp in.nii out.nii DRAG": [
        ("--quality 9", "--quality is for pictures and clips"),
        ("--codec h264", "--codec is for clips"),
        ("--save-field out.txt", "out.txt"),
        ("--save-field out.nii", "cannot be the field"),
        ("--tolerance 0", "tolerance"),
        ("--shape 1,2,3", "both --shape X,Y,Z and --dtype"),
        ("--shape 1,2,3 --dtype text", "dtype"),
        ("--shape 1,2 --dtype u1", "--shape must be numbers of voxels along X,Y,Z"),
        ("--shape 99,99,99 --dtype u1", "in.nii"),
        ("--series 1", "--series is for DICOM"),
        ("--save-field f.nii --save-recipe f.nii", "a recipe is JSON, and none is written as .nii"),
        ("--grab 200,5,5:201,5,5 --radius 5", "24 x 26 x 20 voxels (its point is in voxels here), and reaches"),
    ],
    "warp in.mp4 out.mp4 TIMED": [
        ("--codec ''", "no video encoder"),
        ("--crf abc", "--crf"),
        ("--quality 90", "--quality is for pictures"),
        ("--fps 25", "--fps"),
        ("--fps 0", "--fps"),
        ("--fps nan", "--fps"),
        ("--fps 1e308", "--fps"),
        ("--time-scale 0", "--time-scale"),
        ("--time-scale nan", "--time-scale"),
        ("--time-scale inf", "--time-scale"),
        ("--time-scale 1e300", "--time-scale"),
        ("--memory nan", "--memory"),
        ("--memory -1", "--memory"),
        ("--memory lots", "--memory"),
        ("--between quadratic", "--between"),
        ("--filter nearest --between cubic", "between"),
        ("--tolerance nan", "tolerance"),
        ("--fill 1,2", "fill"),
        ("--outside constant --fill nan", "fill must be finite for the frames of"),
        ("--linear-light", "--linear-light"),
    ],
    "warp in.mp4": [
        ("out%d.png TIMED --codec h264", "--codec is for videos"),
        ("out%d.png TIMED --crf 3", "--crf is for videos"),
        ("out TIMED --preset slow", "--preset is for videos"),
        ("out/ TIMED --pixel-format yuv420p", "--pixel-format is for videos"),
        ("out%d.jpg TIMED --quality 101", "101"),
        ("out.png TIMED", "out.png is one picture, and a clip is many: name an animated one (.webp or .apng), a"),
        ("out.ts TIMED", "the suffix .ts is no video format"),
        ("out%d.txt TIMED", ".txt"),
        ("out%d TIMED", "suffix"),
        ("out%d-%d.png TIMED", "one number"),
        ("no/out.mp4 TIMED", "no folder"),
        ("no/such/folder TIMED", "no folder"),
        ("taken.mp4 TIMED", "--force"),
        ("'' TIMED", "name a file"),
        ("'a\0b.mp4' TIMED", "name"),
        ("LONG.mp4 TIMED", "too long"),
        ("LONG TIMED", "too long"),
        ("/proc/out.mp4 TIMED", "/proc"),
        ("/proc/out TIMED", "/proc"),
        ("in.mp4/out TIMED", "in.mp4"),
    ],
    "warp in.mkv o.mkv --radius 5": [
        ("--grab 30,20,32:30,20,36", "starts outside the clip, which has 64 x 48 pixels and 12 frames (from 0),"),
        ("--grab 30,20,-21:30,20,-25", "reaches nothing of it: use a point inside, a larger radius or a longer"),
        ("--grab 30,20,3:30,20", "X,Y,T:X,Y,T"),
    ],
    "plot in.mkv o.png TIMED": [
        ("--what slice", "--x or --y"),
        ("--what slice --x 3 --y 4", "--x or --y"),
        ("--what slice --x 64", "--x must be from 0 to 63"),
        ("--what slice --x 2.5", "--x must be a whole number of pixels, found '2.5'"),
        ("--what grid --frame 2.5", "--frame must be the number of a frame (0, say) or a timecode"),
        ("--what slice --y 48", "--y must be from 0 to 47"),
        ("--what slice --x -1", "--x must be from 0 to 63"),
        ("--what slice --x 999999999999999999999999999999", "--x must be from 0 to 63"),
        ("--what slice --x 3 --frame 2", "--frame"),
        ("--what sheet --frame 2", "--frame"),
        ("--what sheet --x 2", "slices"),
        ("--what grid --frame 2 --y 2", "slices"),
        ("--frame 12", "from 0 to 11"),
        ("--frame -1", "from 0 to 11"),
        ("--what movie", "movie"),
        ("--what sheet --codec h264", "Unknown option: --codec. It is an option of warp"),
        ("--what sheet --crf 20", "Unknown option: --crf. It is an option of warp"),
        ("--what sheet --fps 20", "--fps"),
    ],
    "warp in.zarr out.zarr FLAT": [
        ("--quality 9", "--quality is for pictures and clips, and in.zarr is a Zarr store"),
        ("--lossless", "--lossless … in.zarr is a Zarr store"),
        ("--linear-light", "--linear-light … in.zarr is a Zarr store"),
        ("--clamp", "--clamp … in.zarr is a Zarr store"),
        ("--no-clamp", "--no-clamp … in.zarr is a Zarr store"),
        ("--time-scale 2", "--time-scale … in.zarr is a Zarr store"),
        ("--fps 2", "--fps … in.zarr is a Zarr store"),
        ("--between cubic", "--between is for clips, and in.zarr is a Zarr store"),
        ("--save-field f.nii", "OME-Zarr … f.nii … name it .zarr"),
        ("--save-field out.zarr", "out.zarr cannot be the field and an image"),
        ("--save-field in.zarr/map.zarr", "cannot be the field and an image"),
        ("--save-field there.zarr", "there.zarr exists already … --force"),
        ("--save-field missing/map.zarr", "missing"),
        ("--save-field memory://x/map.zarr --workers 2", "memory of this process"),
        ("--save-field map.zarr --save-recipe map.zarr", "a recipe is JSON, and none is written as .zarr"),
        ("--series 2", "--series is for DICOM folders, and in.zarr is none: leave it out"),
        ("--world", "--world is for volumes"),
        ("--fill 3", "--outside constant"),
        ("--workers 0", "--workers must be"),
        ("--workers 1 --scheduler tcp://a:1", "give one of them"),
        ("--scheduler nowhere", "nowhere does not answer"),
        ("--crop 0,0,99,99", "--crop must be within"),
    ],
    "invert u.nii v.mha": [
        ("--reference far-head.nii", "u.nii and far-head.nii do not overlap: from ("),
        ("--reference in.png", "u.nii is for volumes, with 3 axes, and in.png is a picture: give two with as"),
        ("--error u.nii --force", "u.nii is read: --force does not replace it"),
        ("--reference a.tfm", "cannot read a.tfm: it is no image"),
        ("--reference nowhere-head.nii", "nowhere-head.nii does not say where its voxels lie in spa"),
        ("--source empty.nii", "cannot read empty.nii: it is empty"),
        ("--status head.nii", "head.nii exists already: choose another name, or --force"),
        ("--report folder --force", "cannot write folder: it is a folder"),
        ("--error v.mha", "v.mha is to be written twice"),
        ("--to spm", "--to must be one of itk, "),
        ("--status s.txt", "--status must be the name of an image: cannot write s.txt: the suffix .txt"),
        ("--error s.png", "--error must be the name of an image: cannot write s.png: the suffix .png"),
        ("--tolerance small", "--tolerance must be a number of voxels from 1e-9 to 1e9"),
        ("--tolerance 0", "--tolerance must be a number of voxels from 1e-9 to 1e9"),
        ("--convention spm", "convention must be one of"),
    ],
    "points seeds.csv o.csv --on head.nii": [
        ("--convention xyz STROKE", "give one, or LPS, RAS or index of points"),
        ("STROKE --convention lps --convention=RAS", "--convention of points is given as LPS and RAS"),
        ("", "nothing to do: give --grab X,Y:X,Y --radius"),
    ],
    "": [
        ("warp in.png x.png GRAB --gpu", "--device gpu is for render and demo"),
        ("warp in.png x.png GRAB --device gpu", 'Choose from: "auto", "cpu", "cuda"'),
        ("plot in.png x.png GRAB --device gpu", "It is an option of warp, render, demo"),
        ("info in.png --device gpu", "It is an option of warp, render, demo"),
        ("warp", "give the files: supple warp IN... OUT --grab"),
        ("convert x.nii", "give the files: supple convert IN OUT [--from NAME]"),
        ("points a.csv b.csv", "give --on, and a value after it"),
        ("warp in.png x.png --radius", "give --radius, and a value after it"),
        ("plan in.png out.zarr", "more names than this command takes: leave out 'out.zarr'"),
        (
            "wrap in.png",
            'Unknown command "wrap". Did you mean "warp"? The commands are warp, face, plot, render, points,',
        ),
        ("frob", "plan, info, view, invert, check, compose, convert, demo (supple --help"),
        ("--versio", 'Unknown option "--versio"'),
        ("warp in.png x.png --grab 9,9:12,9 --grab 9,9,1:12,9,1 --radius 5", "--grab 9,9,1:12,9,1 has points of 3"),
        ("warp in.png GRAB", ""),
        ("info", ""),
        ("plot in.png", ""),
        ("render in.nii out.png --radius 5", "--radius is for strokes, and there are none: give --grab,"),
        ("view in.nii --radius 5", "--radius is for strokes, and there are none: give --grab,"),
        ("compose u.nii far-u.nii --out v.mha", "far-u.nii and what u.nii leads to do not overlap: from ("),
        ("compose u.nii --out v.mha --reference far-head.nii", "u.nii and the grid of the result do not overlap:"),
        ("convert u.nii v.mha --reference far-head.nii", "u.nii and the grid of the result do not overlap: from ("),
        ("invert flow.yml v.npy --reference head.nii", "flow.yml is for pictures, with 2 axes, and head.nii is a"),
        ("convert u.nii v.mha --reference in.png", "u.nii is for volumes, with 3 axes, and in.png is a picture"),
        ("compose u.nii --reference in.png --out v.mha", "u.nii is for volumes, with 3 axes, and in.png is a picture"),
        ("compose flow.yml u.nii --out v.mha", "u.nii is for volumes, with 3 axes, and the result is a picture: give"),
        ("compose a.tfm flow.yml --out v.mha", "a.tfm is for volumes, with 3 axes, and the result is a picture"),
        ("check u.nii flow.yml", "flow.yml is for pictures, with 2 axes, and u.nii is of 3: give two with"),
        ("convert flow.yml v.mha", "it takes maps of volumes, found one of 2 coordinates"),
        ("convert u.nii v.npy", "it takes maps of pictures, found one of 3 coordinates"),
        ("check u.nii --map u.nii --force", "u.nii is read: --force does not replace it, so choose another name"),
        ("compose --inverse u.nii --out v.mha", "--inverse is about the file before it, and there is none"),
        ("check u.nii --convention mrtrix", "its intent code is 1007"),
        ("check u.mha --convention fsl-relative --source head.nii", "it is no NIfTI file"),
        ("check both.h5", "both.h5 holds an affine map and a field, and not one field: supple compose makes one field"),
        ("check u.nii --map j.mhd", "j.mhd: its data would be in a second file: use .mha"),
        ("check u.nii --picture p.jpg", "a plot's name must end in .png, .svg, .pdf"),
        ("check rgb.nii", "its voxels are colours (RGB)"),
        ("check a.tfm", "and not one field: supple compose makes one, on the grid of an image (--reference)"),
        ("check cut.exr", "cannot read cut.exr: it is damaged, cut short or of a kind that is not supported"),
        ("warp small.png o.png --field flow.yml", "flow.yml is a map of 48 x 40 pixels, and small.png, on whose"),
        ("warp small.png o.png --field flow.yml --crop 0,0,5,5", "and small.png, on whose pixels the result is"),
        ("warp small.png o.png --field flow.yml --inverse", "and small.png, which it is applied to, has 30 x 20"),
        ("invert u.nii far-u.nii", "far-u.nii exists already: choose another name, or --force"),
        ("invert u.nii none/v.mha", "cannot write none/v.mha: there is no folder"),
        ("invert b.h5 v.mha", "its grid of 4 x 5 x 6 control points is too coarse for an inverse: give the image"),
        ("convert u.nii v.mha --to spm", "--to must be one of itk, "),
        ("compose u.nii --to spm --out v.mha", "--to must be one of itk, "),
        ("check u.nii --map s.png", "--map must be the name of an image: cannot write s.png: the suffix .png"),
        ("convert u.mha w.nii.gz", "its suffix does not say in which convention to write: give --to "),
        ("convert flow.yml w.tif", "cannot write w.tif: it is not always an STMap: give --to stmap if it is"),
        ("convert u.nii v.txt", "a .txt file holds one affine map, and u.nii a field: use .nii.gz, .nrrd, .mha or"),
        ("convert both.h5 v.nii.gz", "both.h5 holds an affine map and a field, and v.nii.gz one field: give the"),
        ("invert u.nii v.xyz", "cannot write v.xyz: the suffix .xyz is of no transform of ITK: use .nii, "),
        ("check u.nii --map head.nii", "head.nii exists already: choose another name, or --force"),
        ("compose u.nii --out none/v.mha", "cannot write none/v.mha: there is no folder"),
        ("compose u.nii --out head.nii", "head.nii exists already: choose another name, or --force"),
        ("convert u.nii head.nii --to itk", "head.nii exists already: choose another name, or --force"),
        ("warp head.nii far-head.nii --field u.nii", "far-head.nii exists already: choose another name, or --force"),
        ("invert a.tfm v.mha", "cannot write v.mha: a .mha file of ITK holds one field, interpolated linearly: use"),
        ("check u.nii mask.nii", "cannot read mask.nii: it holds one value for each voxel"),
        ("warp clip.mp4 o.mp4 --field flow.yml", "fields and other grids are for pictures and volumes, and clip.mp4"),
        ("warp clip.mp4 o.mp4 GRAB --resample 2", "fields and other grids are for pictures and volumes, and"),
        ("warp in.png out.xyz --field gone.yml", "cannot write out.xyz"),
        ("points seeds.csv o.csv --on clip.mp4 --affine 1,0,2,0,1,3", "fields and other grids are"),
        ("plot clip.mp4 o.png --affine 1,0,2,0,1,3", "fields and other grids are for pictures"),
        ("view clip.mp4 --affine 1,0,2,0,1,3", "fields and other grids are for pictures and volumes, and"),
        ("points seeds.csv o.csv --on in.png --field both.h5", "both.h5 is for volumes"),
        ("render head.nii o.png --inverse", "--inverse is for the --field or --affine before it"),
        ("render head.nii o.png --field both.h5 --mode exact --quiet", "with fields and affine maps, the volume"),
        ("invert none.mha v.mha", "cannot read none.mha: No such file or directory"),
        ("invert a.tfm v.tfm --status s.mha", "holds an affine map: --error and --status are of"),
        ("invert - v.mha", "- for standard input or output is for warp, info and points"),
        ("compose a.tfm --out d.mha", "the maps are affine, and have no grid"),
        ("compose u.nii --typo --out d.mha", "Unknown option: --typo"),
        ("convert u.nii w.nii.gz --to fsl-relative", "give its grid as --source"),
        ("warp in.zarr there.zarr FLAT", "there.zarr exists already … --force"),
        ("warp in.zarr in.zarr out.zarr FLAT", "one at a time"),
        ("warp '*.zarr' out.zarr FLAT", "one at a time"),
        ("warp in.zarr - FLAT", "standard output"),
        ("warp none.zarr out.zarr FLAT", "none.zarr … no such folder"),
        ("warp in.png p.zarr FLAT --quality 9", "--quality is for pictures and clips, and the output is a Zarr store"),
        ("warp in.zarr out.zarr DEEP", "in.zarr is a picture … two numbers"),
        ("warp memory://none/in.zarr out.zarr FLAT --workers 2", "memory of this process"),
        ("warp memory://none/[in].zarr?a=1 out.zarr FLAT", "there is no Zarr array or group"),
        ("warp in.zarr out FLAT", "in.zarr is a Zarr store, and becomes one … name one, such as out.zarr"),
        ("warp in.png out.png FLAT --workers 2", "--workers is for Zarr stores, and in.png is a picture"),
        ("warp in.png o.png GRAB --amount 300%", "--amount must be a part … from -1 to 2, found '300%'"),
        ("warp in.png o.png GRAB --strength -200%", "--strength must be a part … from -1 to 2, found '-200%'"),
        ("warp in.png o.png GRAB --tolerance 1e10", "--tolerance must be … from 1e-9 to 1e9, found '1e10'"),
        ("warp in.png o.png --rotate 999", "--rotate must be a number of degrees from -360 to 360, found '999'"),
        ("warp in.png o.png --resample 0", "--resample must be a spacing S above 0 … found '0'"),
        ("render in.nii o.png --elevation 91", "--elevation must be a number of degrees from -90 to 90, found '91'"),
        ("face in.png o.png --slim 300%", "--slim must be percent from -100 to 100, found '300%'"),
        ("warp in.png o.png --grab 9,9:8,8 --radius 0%", "--radius must be … or a percentage, found '0%'"),
        ("warp in.png o.png --rotate 2 --shear 1,2,3", "--shear must be one number of degrees or two, found '1,2,3'"),
        ("warp in.png o.png --keystone 1,2:3:4,5:6,7", "--keystone must be … found '1,2:3:4,5:6,7'"),
        ("warp in.png o.png --crop 1,2,3.5,4", "--crop must be X,Y,W,H for a picture … found '1,2,3.5,4'"),
        ("warp in.png o.png --scale-to 100x", "--scale-to must be a width, or a width and a height … found '100x'"),
        ("render in.nii o.png --size 400x300x200", "--size must be a width and a height … found '400x300x200'"),
        ("render in.nii o.png --clip 1:2,a:3,:", "--clip must be … found '1:2,a:3,:'"),
        ("render in.nii o.png --plane 1,2:3,4,5", "--plane must be a voxel and a direction … found '1,2:3,4,5'"),
        ("info in.nii --world", "--world is about the points of strokes, and there are none: leave it out"),
        ("plan in.nii --affine 1,0,0,0,0,1,0,0,0,0,1,0 --world", "--world is about the points of strokes"),
        ("plot in.png o.png FLAT --world", "--world is for volumes, and in.png is none: leave it out"),
        ("points p.fcsv q.fcsv --on in.nii DRAG --codec h264", "Unknown option: --codec. It is an option of warp"),
        (
            "info in.raw --shape 10x9x0 --dtype uint8",
            "each number of --shape must be an integer from 1 … found '10x9x0'",
        ),
        ("warp in.png o.png --grab 100", "--grab must be X,Y:X,Y … found '100'"),
        ("render in.nii o.png --size 0x10", "--size must be a number of pixels … found '0x10'"),
        ("info in.raw --shape 5x5 --dtype uint8", "--shape must be numbers of voxels along X,Y,Z … found '5x5'"),
        ("track clip.mp4 o.csv --at 1,x,3", "--at must be X,Y,K … found '1,x,3'"),
        ("info in.png --series 1", "--series is for DICOM folders, and in.png is none: leave it out"),
        ("info in.nii --series 1", "--series is for DICOM folders, and in.nii is none: leave it out"),
        ("plan in.png FLAT --series 1", "--series is for DICOM folders, and in.png is none: leave it out"),
        ("warp in.png o.png FLAT --series 1", "--series is for DICOM folders, and in.png is none: leave it out"),
        ("warp in.nii o.nii DRAG --series 1", "--series is for DICOM folders, and in.nii is none: leave it out"),
        ("plot in.png o.png FLAT --series 1", "--series is for DICOM folders, and in.png is none: leave it out"),
        ("plot in.nii o.png DRAG --series 1", "--series is for DICOM folders, and in.nii is none: leave it out"),
        ("render in.nii o.png --series 1", "--series is for DICOM folders, and in.nii is none: leave it out"),
        (
            "points p.fcsv q.fcsv --on in.nii DRAG --series 1",
            "--series is for DICOM folders, and in.nii is none: leave it out",
        ),
        ("view in.png --series 1", "--series is for DICOM folders, and in.png is none: leave it out"),
        ("info in.png --irregular resample", "--irregular is for DICOM folders, and in.png is none: leave it out"),
        ("info in.nii --irregular resample", "--irregular is for DICOM folders, and in.nii is none: leave it out"),
        ("info folder --irregular resample", "--irregular is for DICOM folders, and folder is none: leave it out"),
        ("plan in.png FLAT --irregular resample", "--irregular is for DICOM folders, and in.png is none: leave it out"),
        ("view in.png --irregular resample", "--irregular is for DICOM folders, and in.png is none: leave it out"),
        ("warp in.zarr missing/out.zarr FLAT", "missing"),
        ("warp in.nii out.jpg DRAG", "no format that volumes are written in"),
        ("warp in.nii in.nii DRAG", "is the volume itself: choose another name, or --force"),
        ("warp in.nii there.nii DRAG", "exists already"),
        ("warp in.raw out.nii DRAG", "--shape"),
        ("warp missing.nii out.nii DRAG", "missing.nii"),
        ("warp text.nii.gz out.nii DRAG", "text.nii.gz"),
        ("warp photo.png out.png --grab 1,1:2,2 --radius 3 --save-field f.nii", "f.nii is no map of a picture"),
        ("warp in.nii out.nii --grab 1,1:2,2 --radius 3", "three numbers"),
        ("plot in.nii out.png DRAG --what residual", "draw grid or stretch"),
        ("render in.nii out.png --time 1", "--time is for series"),
        ("warp stack.tif o.tif DRAG --world", "stack.tif does not know where it lies in space: leave --world out"),
        ("points p.fcsv q.fcsv --on stack.tif DRAG", "does not know where it lies in space"),
        ("plot in.mkv o.png --grab 30,20,32:30,20,36 --radius 5 --what sheet", "starts outside the clip, which has"),
    ],
}


@pytest.mark.parametrize(("begin", "rest", "said"), [(k, *row) for k, rows in REFUSED.items() for row in rows])
def test_what_cannot_be_is_one_line(
    inputs: Path, run: Run, monkeypatch: pytest.MonkeyPatch, begin: str, rest: str, said: str
) -> None:
    monkeypatch.chdir(inputs)
    line = f"{begin} {rest}"
    for word, meaning in WORDS.items():
        line = line.replace(word, meaning)
    before = {path: path.stat().st_mtime_ns for path in inputs.rglob("*")}
    status, out, err = run(*shlex.split(line))
    assert (status, out) == (2, ""), err
    for part in said.split(" … "):
        assert part in one_line(err)
    assert "fault" not in err
    assert {path: path.stat().st_mtime_ns for path in inputs.rglob("*")} == before


@pytest.mark.parametrize(("begin", "name"), [(begin, name) for begin, names in WHOLE.items() for name in names])
def test_whole_numbers_are_not_rounded(run: Run, begin: str, name: str) -> None:
    for text in ("1.5", "1.0", "x"):
        status, out, err = run(*begin.split(), f"--{name}", text)
        assert (status, out) == (2, "")
        assert one_line(err) == f"supple: --{name} must be a whole number, found {text!r}\n"


def test_whole_numbers_are_all_in_that_table() -> None:
    source = "".join(path.read_text("utf-8") for path in Path(supple.__file__).parent.joinpath("cli").glob("*.py"))
    found = re.findall(r"(\w+): Annotated\[int\b[^,]*, (\w+)\((.*?)\)\]", source)
    assert {name for name, kind, more in found if "count=True" not in more} == {
        name.replace("-", "_") for names in WHOLE.values() for name in names
    }
    assert all(kind == "whole" for _, kind, more in found if "count=True" not in more)


@pytest.mark.parametrize("name", ["missing", "cut", "folder"])
def test_what_is_no_picture_is_one_line(run: Run, name: str) -> None:
    Path("cut").write_bytes(Path("in.png").read_bytes()[:3000])
    Path("folder").mkdir()
    before = sorted(os.listdir())
    for arguments in (["warp", name, "out.png", *GRAB], ["plot", name, "out.png", *GRAB]):
        status, out, err = run(*arguments)
        assert (status, out) == (2, "")
        assert name in one_line(err)
        assert sorted(os.listdir()) == before


@pytest.mark.parametrize(
    ("target", "wanted"),
    [
        ("out.xyz", ".xyz"),
        ("out", "suffix"),
        ("none/out.png", "none"),
        ("in.png/out.png", "in.png"),
        ("taken.png", "--force"),
        ("in.png", "--force"),
        ("link.png", "--force"),
        ("a\0b.png", "name"),
        ("x" * 300 + ".png", "xxx"),
        ("", "name a file"),
        ("/proc/out.png", "/proc"),
    ],
)
def test_what_cannot_be_written_is_one_line_before_any_work(
    run: Run, monkeypatch: pytest.MonkeyPatch, target: str, wanted: str
) -> None:
    Path("taken.png").write_bytes(b"precious")
    Path("link.png").symlink_to("in.png")
    kept = Path("in.png").read_bytes()
    if target != "/proc/out.png":  # whether that can be written is only found out by writing
        monkeypatch.setattr("supple.files.pictures.read", lambda path: pytest.fail("it was read"))
    status, out, err = run("warp", "in.png", target, *GRAB)
    assert (status, out) == (2, "")
    assert wanted in one_line(err)
    assert Path("taken.png").read_bytes() == b"precious"
    assert Path("in.png").read_bytes() == kept
    assert sorted(os.listdir()) == ["in.png", "link.png", "taken.png"]


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is forbidden to root")
def test_a_folder_without_rights_is_one_line(run: Run) -> None:
    Path("shut").mkdir(mode=0o555)
    status, out, err = run("warp", "in.png", "shut/out.png", *GRAB)
    assert (status, out) == (2, "")
    assert "shut/out.png" in one_line(err)


def test_a_picture_is_replaced_with_force_through_a_link_too(run: Run) -> None:
    Path("link.png").symlink_to("in.png")
    before = Path("in.png").read_bytes()
    assert run("warp", "in.png", "link.png", *GRAB, "--force") == (0, "", "")
    assert Path("link.png").is_symlink()
    assert Path("in.png").read_bytes() != before
    assert sorted(os.listdir()) == ["in.png", "link.png"]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("", "JSON"),
        ('{"supple": 1, "strokes": [{"brush": "grab", "at": [1, 2, 3], "by": [1, 1, 1], "radius": 5}]}', "2 numbers"),
        ("\udcff", "text"),
    ],
)
def test_a_wrong_recipe_is_one_line(run: Run, text: str, wanted: str) -> None:
    Path("r.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    status, out, err = run("warp", "in.png", "out.png", "--recipe", "r.json")
    assert (status, out) == (2, "")
    assert wanted in one_line(err)
    assert sorted(os.listdir()) == ["in.png", "r.json"]


def test_recipes_are_not_overwritten(run: Run) -> None:
    Path("r.json").write_text("precious")
    status, _, err = run("warp", "in.png", "out.png", *GRAB, "--save-recipe", "r.json")
    assert status == 2
    assert "--force" in one_line(err)
    assert Path("r.json").read_text() == "precious"
    assert not Path("out.png").exists()
    assert run("warp", "in.png", "out.png", *GRAB, "--save-recipe", "r.json", "--force")[0] == 0
    assert supple.Recipe.from_json(Path("r.json").read_text()).strokes
