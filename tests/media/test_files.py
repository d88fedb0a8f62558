import contextlib
import errno
import os
import stat
import tempfile
from pathlib import Path
from types import SimpleNamespace

import pytest

from supple.errors import SuppleError, shown
from supple.media.files import check_output, replacing, replacing_together

posix = pytest.mark.skipif(os.name != "posix", reason="permission bits are POSIX's")


def put(path, data=b"new", *, force=False, then=lambda: None):
    with replacing(path, force=force) as temporary:
        temporary.write_bytes(data)
        then()


@contextlib.contextmanager
def unprivileged():
    """Be nobody for a while, when root: no permission binds root."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.fixture
def public():
    """A folder that everybody may write into; pytest's own are closed to others."""
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o777)
        yield Path(folder)
        os.chmod(folder, 0o777)


def test_the_temporary_file_is_hidden_beside_the_target_and_keeps_its_suffixes(tmp_path):
    with replacing(tmp_path / "brain.nii.gz") as temporary:
        assert temporary.parent == tmp_path
        assert temporary.name.startswith(".")
        assert temporary.name.endswith(".nii.gz")
        assert not (tmp_path / "brain.nii.gz").exists()


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, ZeroDivisionError, SuppleError])
@pytest.mark.parametrize("force", [False, True])
def test_whatever_ends_the_work_leaves_the_folder_as_it_was(tmp_path, error, force):
    target = tmp_path / "out.png"
    if force:
        target.write_bytes(b"old")

    def fail():
        raise error

    with pytest.raises(error):
        put(target, b"half", force=force, then=fail)
    assert os.listdir(tmp_path) == (["out.png"] if force else [])
    assert not force or target.read_bytes() == b"old"


def test_a_file_that_appears_meanwhile_is_kept(tmp_path):
    target = tmp_path / "out.png"
    with pytest.raises(SuppleError, match="exists already"):
        put(target, b"mine", then=lambda: target.write_bytes(b"theirs"))
    assert target.read_bytes() == b"theirs"
    assert os.listdir(tmp_path) == ["out.png"]


@pytest.fixture
def no_links(monkeypatch):
    def link(*_args, **_kwargs):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", link)


@pytest.mark.usefixtures("no_links")
def test_file_systems_without_links_do_as_well(tmp_path):
    put(tmp_path / "out.png")
    assert (tmp_path / "out.png").read_bytes() == b"new"
    two = tmp_path / "two.png"
    with pytest.raises(SuppleError, match="exists already"):
        put(two, b"mine", then=lambda: two.write_bytes(b"theirs"))
    assert two.read_bytes() == b"theirs"
    assert sorted(os.listdir(tmp_path)) == ["out.png", "two.png"]


@pytest.mark.usefixtures("no_links")
def test_an_interrupted_rename_leaves_nothing(tmp_path, monkeypatch):
    def replace(*_args):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(KeyboardInterrupt):
        put(tmp_path / "out.png")
    assert os.listdir(tmp_path) == []


@posix
def test_permission_bits_follow_the_umask_and_the_replaced_file(tmp_path):
    target = tmp_path / "out.png"
    before = os.umask(0o027)
    try:
        put(target)
    finally:
        os.umask(before)
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    target.chmod(0o604)
    put(target, b"again", force=True)
    assert stat.S_IMODE(target.stat().st_mode) == 0o604


@posix
def test_a_link_stays_and_what_it_points_at_is_replaced(tmp_path):
    (tmp_path / "far").mkdir()
    real, link = tmp_path / "far" / "real.png", tmp_path / "link.png"
    real.write_bytes(b"old")
    link.symlink_to(real)
    with pytest.raises(SuppleError, match=r"link\.png exists already"):
        put(link)
    put(link, force=True)
    assert link.is_symlink()
    assert real.read_bytes() == b"new"
    real.unlink()
    put(link, b"made")
    assert real.read_bytes() == b"made"
    assert os.listdir(tmp_path / "far") == ["real.png"]


@posix
@pytest.mark.parametrize("force", [False, True])
def test_only_plain_files_are_written_over(tmp_path, force):
    loop, pipe = tmp_path / "loop.png", tmp_path / "pipe.png"
    loop.symlink_to(loop)
    os.mkfifo(pipe)
    for path in (loop, pipe):
        with pytest.raises(SuppleError, match=r"no plain file: give another name$"):
            put(path, force=force)
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@posix
def test_a_folder_without_rights_is_refused_before_the_work(public):
    (public / "out.png").write_bytes(b"old")
    with unprivileged():
        put(public / "new.png")  # so it is the bits that make the difference below
    public.chmod(0o555)
    with unprivileged():
        for name in ("two.png", "out.png"):
            with pytest.raises(SuppleError, match=r"no right to write into its folder: choose a place where"):
                check_output(public / name, force=True)
        with pytest.raises(SuppleError, match="no right"), replacing(public / "two.png"):
            pytest.fail("the work has begun")
    assert sorted(os.listdir(public)) == ["new.png", "out.png"]
    public.chmod(0o000)
    with unprivileged(), pytest.raises(SuppleError, match="Permission denied: choose a place where"):
        put(public / "two.png")


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs a folder that lets nobody write")
def test_what_the_rights_do_not_tell_is_found_before_the_work():
    with (
        pytest.raises(SuppleError, match=r"^cannot write /proc/self/out\.png: "),
        replacing("/proc/self/out.png"),
    ):
        pytest.fail("the work has begun")


def test_the_trouble_of_another_file_names_it(tmp_path):
    with pytest.raises(SuppleError, match=r"out\.png: No such file or directory \(.*other\.png\): "):
        put(tmp_path / "out.png", then=(tmp_path / "other.png").read_bytes)


@pytest.mark.parametrize(
    ("name", "text"),
    [("a b.png", "a b.png"), ("é.png", "é.png"), ("", "''"), ("a\nb", r"'a\nb'"), ("\udcff", r"'\udcff'")],
)
def test_names_are_shown_in_one_line(name, text):
    assert shown(name) == text


@pytest.mark.parametrize("code", [-1, errno.EIO, errno.EPERM])
def test_a_full_disk_is_said_whatever_a_library_says(tmp_path, monkeypatch, code):
    def fail(free):
        monkeypatch.setattr("shutil.disk_usage", lambda folder: SimpleNamespace(free=free))
        with pytest.raises(SuppleError) as caught, replacing(tmp_path / "out.mp4"):
            raise OSError(code, os.strerror(code))
        assert os.listdir(tmp_path) == []
        return str(caught.value)

    assert fail(0).endswith("out.mp4: No space left on device: make room or choose another place")
    assert os.strerror(code) in fail(1 << 30)


@pytest.mark.parametrize("failing", [0, 1, 2, None])
def test_files_in_several_folders_appear_together_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int | None
) -> None:
    """Though a rename fails, or is interrupted, after others are done."""
    (tmp_path / "deep").mkdir()
    paths = [tmp_path / "a.txt", tmp_path / "deep" / "b.txt", tmp_path / "c.txt"]
    paths[0].write_text("before")
    paths[2].write_text("before")
    rename, done = os.rename, []

    def breaking(before: Path, after: Path) -> None:
        if failing is not None and Path(after) == paths[failing] and paths[failing] not in done:
            done.append(after)
            raise KeyboardInterrupt if failing == 1 else OSError(errno.EIO, "Input/output error")
        rename(before, after)

    def write() -> None:
        with replacing_together(paths, force=True) as hidden:
            for each in hidden:
                assert each.suffix == ".txt"
                each.write_text("after")
            assert [path.read_text() for path in paths if path.exists()] == ["before", "before"]

    with monkeypatch.context() as patch:
        patch.setattr("os.rename", breaking)
        if failing is None:
            write()
        else:
            with pytest.raises(KeyboardInterrupt if failing == 1 else SuppleError):
                write()
    expected = ["after"] * 3 if failing is None else ["before", None, "before"]
    assert [path.read_text() if path.exists() else None for path in paths] == expected
    assert sorted(os.listdir(tmp_path)) == ["a.txt", "c.txt", "deep"]
    assert os.listdir(tmp_path / "deep") == ["b.txt"] * (failing is None)
