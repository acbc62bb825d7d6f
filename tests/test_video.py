"""Moving pictures: what is decoded again moves as it should, lasts as long, and refuses nicely."""

import importlib.util
import itertools
import sys
import weakref
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from qpctrl import InputError
from scenarios.plant_model import robot_from_mujoco
from scenarios.video import screen as video_screen
from scenarios.video.reel import Reel
from scenarios.video.run import Scene, board_view, film_run, force_arrows
from scenarios.video.screen import Pixels
from scenarios.video.take import Arrow, Take, View
from scenarios.video.write import FORMATS, check_video, checked_writer, sampled, write_video

SCENE = """
<mujoco>
  <worldbody>
    <light pos="0 -3 3" dir="0 0.7 -0.7"/>
    <body name="slider">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom type="sphere" size="0.15" rgba="0.9 0.1 0.1 1" mass="1"/>
      <site name="tool" euler="90 0 0" rgba="0 0 0 0"/>
    </body>
    <body name="screen" pos="0 1 0">
      <geom type="box" size="1.5 0.01 1.5" rgba="0.2 0.3 0.8 1"/>
      <body name="knob"><geom type="sphere" size="0.01"/></body>
    </body>
  </worldbody>
</mujoco>
"""
MODEL = mujoco.MjModel.from_xml_string(SCENE)
ROBOT = robot_from_mujoco(MODEL)
SIZE, FPS, FRAMES = (192, 128), 10.0, 12
VIEW = View(azimuth=90.0, elevation=0.0, distance=2.0, lookat=(0.0, 0.0, 0.0), shadows=False)
"""Along y of the world, x to the right and z up."""
FOCAL = SIZE[1] / 2 / np.tan(np.radians(MODEL.vis.global_.fovy / 2))
"""Of a camera without lens errors [pixels]."""

A_PIXEL = 0.6
"""Of the middle of a sphere [pixels]: it is shaded, and seen under a small angle."""
LOSS = 33.0
"""Peak signal-to-noise ratio [dB] of the lossy formats, at least: what is lost is hard to see."""
NEARLY = 32
"""Error of a colour in a GIF of 255 [1/255]: with 6 steps a channel the nearest is that far off."""
ALIVE = 3
"""Pictures at once: the one made, the one before it, and what an encoder looks at."""

NEEDS = {suffix: kind.module for suffix, kind in FORMATS.items() if kind.extra == "video"}
MISSING = importlib.util.find_spec("av") is None
needs_av = pytest.mark.skipif(MISSING, reason="the extra video is not installed")
SUFFIXES = [pytest.param(s, marks=needs_av if s in NEEDS else ()) for s in FORMATS]
each_format = pytest.mark.parametrize("suffix", SUFFIXES)


class Shown(NamedTuple):
    """What a decoder makes of a file."""

    frames: list[Pixels]
    duration: float
    """Of the whole file [s]."""


def shown(file: Path) -> Shown:
    """Return what a file shows, by the decoders of others."""
    if file.suffix in NEEDS:
        import av

        with av.open(str(file)) as container:
            stream = container.streams.video[0]
            frames = [f.to_ndarray(format="rgb24") for f in container.decode(stream)]
            return Shown(frames, len(frames) / float(stream.average_rate))
    frames, milliseconds = [], 0.0
    with Image.open(file) as image:
        assert image.info["loop"] == 0
        for k in range(image.n_frames):
            image.seek(k)
            frames.append(np.asarray(image.convert("RGB")))
            milliseconds += image.info["duration"]
    return Shown(frames, milliseconds / 1e3)


def swing(frames: int = FRAMES) -> np.ndarray:
    """Return configurations in which the sphere goes from left to right and up."""
    return np.column_stack([np.linspace(-0.5, 0.5, frames), np.linspace(-0.2, 0.2, frames)])


def middle(pixels: Pixels) -> np.ndarray:
    """Return where the red sphere is, from the middle of the picture: right and up [pixels]."""
    red = pixels[..., 0].astype(float) - pixels[..., 1:].max(axis=2)
    rows, columns = np.nonzero(red > 60)
    assert len(rows) > 20
    return np.array([columns.mean() + 0.5 - SIZE[0] / 2, SIZE[1] / 2 - rows.mean() - 0.5])


def noise_ratio(pixels: Pixels, exact: Pixels) -> float:
    """Return the peak signal-to-noise ratio [dB]."""
    error = np.mean((pixels.astype(float) - exact) ** 2)
    return float(10 * np.log10(255**2 / error)) if error else np.inf


def pictures(qpos: np.ndarray, view: View = VIEW, **shots: Any) -> list[Pixels]:
    """Return the pictures of a run before they are written."""
    with Take(model=MODEL, qpos=qpos, view=view, **shots).shot(SIZE) as picture:
        return [picture(k) for k in range(len(qpos))]


@each_format
def test_what_is_decoded_shows_each_frame_where_a_pinhole_camera_sees_it(
    suffix: str, tmp_path: Path
) -> None:
    file, qpos = tmp_path / f"run{suffix}", swing()
    write_video(file, MODEL, qpos, view=VIEW, fps=FPS, size=SIZE)
    frames, duration = shown(file)
    assert len(frames) == FRAMES
    assert frames[0].shape == (*SIZE[::-1], 3)
    assert duration == pytest.approx(FRAMES / FPS, abs=1e-9)
    seen = np.array([middle(pixels) for pixels in frames])
    assert np.abs(seen - FOCAL * qpos / VIEW.distance).max() < A_PIXEL
    moved = [(a != b).any(axis=2).sum() for a, b in itertools.pairwise(frames)]
    assert min(moved) > 50


@each_format
def test_what_is_decoded_is_what_was_rendered(suffix: str, tmp_path: Path) -> None:
    file, qpos = tmp_path / f"run{suffix}", swing(5)
    write_video(file, MODEL, qpos, view=VIEW, fps=FPS, size=SIZE)
    worst = min(map(noise_ratio, shown(file).frames, pictures(qpos)))
    assert worst == np.inf if suffix == ".png" else LOSS < worst < np.inf


@each_format
def test_the_same_run_gives_the_same_bytes(suffix: str, tmp_path: Path) -> None:
    files = [tmp_path / f"{name}{suffix}" for name in ("one", "other")]
    for file in files:
        write_video(file, MODEL, swing(6), view=VIEW, fps=FPS, size=SIZE)
    assert files[0].read_bytes() == files[1].read_bytes()


@each_format
def test_a_run_at_rest_lasts_as_long_as_one_that_moves(suffix: str, tmp_path: Path) -> None:
    file, qpos = tmp_path / f"run{suffix}", np.repeat(swing(2), (1, 9), axis=0)
    write_video(file, MODEL, qpos, view=VIEW, fps=FPS, size=SIZE)
    frames, duration = shown(file)
    assert duration == pytest.approx(1.0, abs=1e-9)
    assert np.abs(middle(frames[-1]) - FOCAL * qpos[-1] / VIEW.distance).max() < A_PIXEL


@each_format
def test_one_picture_is_a_run_too(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"run{suffix}"
    write_video(file, MODEL, swing(1), view=VIEW, fps=FPS, size=SIZE)
    if suffix in NEEDS:
        assert len(shown(file).frames) == 1
    else:
        with Image.open(file) as image:
            assert image.size == SIZE


@each_format
def test_pictures_are_made_one_at_a_time(suffix: str, tmp_path: Path) -> None:
    """However long the run: few pictures live at once, and turns come in order."""
    width, height = SIZE
    alive: weakref.WeakSet[Any] = weakref.WeakSet()
    most, turns = 0, []

    class Tracked(np.ndarray):
        """An array that says when it is gone."""

        def __hash__(self) -> int:  # type: ignore[override]
            return id(self)

    def picture(k: int) -> Pixels:
        nonlocal most
        pixels = np.full((height, width, 3), k, np.uint8).view(Tracked)
        pixels[: 1 + k] = 255 - k
        alive.add(pixels)
        most = max(most, len(alive))
        return pixels

    write = checked_writer(tmp_path / f"run{suffix}", FPS, SIZE)
    reel = Reel(picture=picture, count=50, fps=FPS, size=SIZE, watch=turns.append)
    write(tmp_path / f"run{suffix}", reel)
    assert turns == list(range(50))
    assert most <= ALIVE


def test_a_gif_of_more_colours_than_it_can_have_shows_each_nearly(tmp_path: Path) -> None:
    """None of its colours is the one through which the picture before is seen."""
    down, across = np.mgrid[0:64, 0:96]
    shades = np.stack((0 * down, 255 - 2 * across, 3 * down), axis=2).astype(np.uint8)

    def picture(k: int) -> Pixels:
        return shades[:: (-1) ** k, :: (-1) ** k].copy()

    write = checked_writer(tmp_path / "run.gif", FPS, (96, 64))
    write(tmp_path / "run.gif", Reel(picture=picture, count=5, fps=FPS, size=(96, 64)))
    for k, frame in enumerate(shown(tmp_path / "run.gif").frames):
        assert np.abs(frame.astype(int) - picture(k)).max() < NEARLY


@pytest.mark.parametrize("fps", [30.0, 29.97, 24.0, 12.5])
@pytest.mark.parametrize("suffix", [".gif", ".webp", ".png"])
def test_rounded_delays_do_not_add_up(suffix: str, fps: float, tmp_path: Path) -> None:
    file, frames = tmp_path / f"run{suffix}", 47
    write_video(file, MODEL, swing(frames), view=VIEW, fps=fps, size=SIZE)
    unit = {".gif": 1e-2, ".webp": 1e-3, ".png": 1e-6}[suffix]
    assert shown(file).duration == pytest.approx(frames / fps, abs=unit)


@settings(derandomize=True, max_examples=50, deadline=None)
@given(fps=st.floats(1, 60), count=st.integers(1, 400), second=st.sampled_from([100, 1000]))
def test_each_delay_is_the_exact_one_rounded_up_or_down(
    fps: float, count: int, second: int
) -> None:
    reel = Reel(picture=lambda _: swing(), count=count, fps=fps, size=SIZE)
    delays = reel.delays(second)
    assert abs(reel.rate - fps) < 1e-3
    assert sum(delays) == pytest.approx(count * second / float(reel.rate), abs=0.51)
    assert np.abs(np.array(delays) - second / float(reel.rate)).max() < 1


def test_an_arrow_is_drawn_where_its_force_acts() -> None:
    qpos, blue = swing(1), (0.0, 0.0, 1.0)
    arrow = Arrow(point=[0.1, -0.5, 0.2], vector=[0, 0, -100], colour=blue, scale=0.004)
    (plain,), (drawn,) = pictures(qpos), pictures(qpos, arrows=[[arrow]])
    rows, columns = np.nonzero((plain != drawn).any(axis=2))
    near = VIEW.distance - 0.5  # the arrow is before the middle of the scene
    ends = SIZE[1] / 2 - FOCAL * np.array([0.2, -0.2]) / near
    assert abs(columns.mean() + 0.5 - SIZE[0] / 2 - FOCAL * 0.1 / near) < A_PIXEL
    assert np.abs([rows.min(), rows.max() + 1] - ends).max() < 1.5
    inside = drawn[rows.min() + 3 : rows.max() - 3, int(columns.mean())]
    assert (inside[:, 2] > inside[:, 0].astype(int) + 40).all()


def test_an_arrow_behind_something_is_half_seen() -> None:
    """Behind the blue screen a green arrow is a mixture; before it, its own colour."""
    green, up = (0.0, 1.0, 0.0), np.array([0.0, 0.0, 100.0])
    place, qpos = np.array([0.3, 0.0, -0.2]), np.array([[-0.5, 0.0]])
    greens = []
    for depth in (0.5, 1.5):  # the screen is at 1
        point = place + np.array([0.0, depth, 0.0])
        arrow = Arrow(point=point, vector=up, colour=green, scale=0.004)
        (plain,), (drawn,) = pictures(qpos), pictures(qpos, arrows=[[arrow]])
        column = int(SIZE[0] / 2 + FOCAL * 0.3 / (VIEW.distance + depth))
        row = int(SIZE[1] / 2 + FOCAL * 0.05 / (VIEW.distance + depth))
        greens.append(int(drawn[row, column, 1]) - int(plain[row, column, 1]))
    assert greens[0] > greens[1] > 20


def test_a_thin_arrow_keeps_its_colour_in_a_gif(tmp_path: Path) -> None:
    green = Arrow(point=[0.3, 0.5, 0.3], vector=[0, 0, 100], colour=(0.0, 0.7, 0.1), scale=0.001)
    file, qpos, arrows = tmp_path / "run.gif", swing(), [[], [green]] * (FRAMES // 2)
    write_video(file, MODEL, qpos, view=VIEW, fps=FPS, size=SIZE, arrows=arrows)
    plain, drawn = pictures(qpos)[1], pictures(qpos, arrows=arrows)[1]
    of_arrow = np.abs(drawn.astype(int) - plain).max(axis=2) > 100
    assert of_arrow.sum() > 8
    error = np.abs(shown(file).frames[1].astype(int) - drawn)
    assert error[of_arrow].mean() < NEARLY


def test_a_force_of_zero_is_not_drawn() -> None:
    nothing = Arrow(point=np.zeros(3), vector=np.zeros(3))
    (plain,), (drawn,) = pictures(swing(1)), pictures(swing(1), arrows=[[nothing]])
    assert (plain == drawn).all()


def test_a_body_that_is_placed_is_seen_there() -> None:
    """The screen, 3 m wide, turns by 22.5° about y, then comes in front of the sphere."""
    turned = pin.SE3(pin.utils.rotate("y", np.pi / 8), np.array([0.0, 1.0, 0.0]))
    ahead, kept = pin.SE3(np.eye(3), np.array([0.0, -0.5, 0.0])), MODEL.body_pos.copy()
    poses = np.stack([turned.homogeneous, ahead.homogeneous])
    first, second = pictures(np.zeros((2, 2)), places={"screen": poses})
    assert np.abs(middle(first)).max() < A_PIXEL
    corner = 1.8 * np.array([np.cos(np.pi / 8), np.sin(np.pi / 8)])  # of the turned screen
    right, up = (FOCAL * corner / (VIEW.distance + 1)).astype(int)
    column, row = SIZE[0] // 2 + right, SIZE[1] // 2
    redness = first[[row - up, row + up], column, 0]
    assert redness[0] < 120 < 200 < redness[1]
    hidden = second[..., 0].astype(int) - second[..., 2]
    assert not (hidden > 60).any()
    assert np.array_equal(MODEL.body_pos, kept)


def test_shadows_can_be_left_out() -> None:
    (dark,), (light,) = (pictures(swing(1), replace(VIEW, shadows=on)) for on in (True, False))
    darker = light.astype(int) - dark
    assert (darker[..., 2] > 40).sum() > 100  # on the blue screen


def test_samples_of_a_record_are_the_nearest() -> None:
    times = 5.0 + np.array([0.0, 0.02, 0.09, 0.12, 0.24, 0.26, 0.3])
    values = np.arange(7.0)[:, None] * [1.0, 10.0]
    assert sampled(times, values, 10.0)[:, 1].tolist() == [0.0, 20.0, 40.0, 60.0]
    assert sampled(times[:1], values[:1], 10.0).tolist() == [[0.0, 0.0]]
    whole = 1e-3 * np.arange(10_000)
    assert len(sampled(whole, whole, 25.0)) == 250


@settings(derandomize=True, max_examples=50, deadline=None)
@given(
    steps=st.lists(st.floats(1e-3, 0.3), min_size=1, max_size=40),
    fps=st.floats(1, 60),
    start=st.floats(-5, 5),
)
def test_no_row_of_a_record_is_nearer_than_the_one_sampled(
    steps: list[float], fps: float, start: float
) -> None:
    times = start + np.cumsum(steps)
    rows = sampled(times, np.arange(len(times)), fps)
    wanted = times[0] + np.arange(len(rows)) / fps
    gaps = np.abs(times[:, None] - wanted)
    assert (np.abs(times[rows] - wanted) <= gaps.min(axis=0) + 1e-9).all()
    assert 0 <= times[-1] - wanted[-1] + 1e-6 < 1 / fps + 2e-6


@pytest.mark.parametrize(
    ("times", "values", "message"),
    [
        ([], [], "got 0 times and 0 values"),
        ([0.0, 0.1], [1.0], "got 2 times and 1 values"),
        ([0.0, 0.1, 0.1], [1.0, 2.0, 3.0], "do not rise"),
        ([0.0, np.nan], [1.0, 2.0], "do not rise"),
    ],
)
def test_a_record_that_cannot_be_sampled_is_refused(
    times: list[float], values: list[float], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        sampled(np.array(times), np.array(values), 25.0)


def not_finite() -> np.ndarray:
    """Return a run that diverges in its third frame."""
    qpos = swing()
    qpos[2:, 1] = np.inf
    return qpos


BAD_FILES = {
    "suffix": ("run.avi", {}, r"unknown suffix of a video '.avi'; allowed: .gif, .mp4"),
    "none": ("run", {}, "unknown suffix of a video ''"),
    "fast gif": ("run.gif", {"fps": 60.0}, "fps: got 60.0, need 1 to 50 pictures/s in a .gif"),
    "fast": ("run.png", {"fps": np.inf}, "fps: got inf, need 1 to 60"),
    "slow": ("run.png", {"fps": 0.0}, "fps: got 0.0, need 1"),
    "nan": ("run.png", {"fps": np.nan}, "fps: got nan"),
    "small": ("run.gif", {"size": (0, 48)}, "size: got 0×48, need numbers from 16"),
    "large": ("run.gif", {"size": (64, 9999)}, "size: got 64×9999"),
    "long": ("a" * 300 + ".gif", {}, "video '.*/a*.gif': File name too long"),
    "folder": ("folder.gif", {}, "folder.gif is a folder there"),
    "no folder": ("file/run.gif", {}, "output folder .*file': File exists"),
}


@pytest.mark.parametrize("write", [False, True], ids=["checked", "written"])
@pytest.mark.parametrize(("name", "given", "message"), BAD_FILES.values(), ids=BAD_FILES)
def test_a_file_that_cannot_be_written_is_refused_in_one_line(
    name: str, given: dict[str, Any], message: str, write: bool, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder.gif").mkdir()
    refuse = partial(write_video, model=MODEL, qpos=swing(), view=VIEW) if write else check_video
    with pytest.raises(InputError, match=message) as caught:
        refuse(tmp_path / name, **given)
    assert "\n" not in str(caught.value)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder.gif"]


BAD_RUNS: dict[str, tuple[dict[str, Any], str]] = {
    "empty": ({"qpos": np.zeros((0, 2))}, r"qpos: got shape \(0, 2\), need \(frames, 2\), one"),
    "other": ({"qpos": np.zeros((4, 3))}, r"qpos: got shape \(4, 3\), need \(frames, 2\)"),
    "flat": ({"qpos": np.zeros(2)}, r"qpos: got shape \(2,\)"),
    "wild": ({"qpos": not_finite()}, "qpos: frame 2 is not finite"),
    "arrows": ({"arrows": [[]]}, "arrows: got those of 1 frames, need 12"),
    "name": ({"places": {"scren": np.zeros((12, 4, 4))}}, "'scren'.*did you mean 'screen'"),
    "knob": ({"places": {"knob": np.zeros((12, 4, 4))}}, "unknown body on the world 'knob'"),
    "places": ({"places": {"screen": np.zeros((3, 4, 4))}}, r"need finite poses \(12, 4, 4\)"),
}


@pytest.mark.parametrize(("given", "message"), BAD_RUNS.values(), ids=BAD_RUNS)
def test_a_run_that_cannot_be_shown_is_refused(
    given: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        write_video(tmp_path / "run.png", MODEL, **{"qpos": swing(), "view": VIEW, **given})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: View(distance=0.0), "distance of the view"),
        (lambda: View(azimuth=np.nan), "view: got"),
        (lambda: Arrow(point=[0, 0], vector=[0, 0, 1]), "arrow point"),
        (lambda: Arrow(point=[0, 0, 0], vector=[0, 0, np.nan]), "arrow vector"),
    ],
)
def test_views_and_arrows_check_their_numbers(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


@needs_av
@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_an_odd_size_is_refused_where_colours_are_shared(suffix: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="need even numbers"):
        check_video(tmp_path / f"run{suffix}", size=(97, 64))


@pytest.mark.parametrize(
    ("suffix", "package", "extra"),
    [(".mp4", "av", "video"), (".webm", "av", "video"), (".gif", "PIL", "scenarios")],
)
def test_an_extra_that_is_missing_is_named(
    suffix: str, package: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, FORMATS[suffix].module, raising=False)
    with pytest.raises(InputError, match=rf"a {suffix} needs the extra: .*qpctrl\[{extra}\]"):
        check_video(tmp_path / f"run{suffix}")
    check_video(tmp_path / "run.png")


@each_format
def test_a_failure_on_the_way_leaves_what_was_there(suffix: str, tmp_path: Path) -> None:
    class StopError(Exception):
        """Somebody has seen enough."""

    def stop(k: int) -> None:
        if k == 3:
            raise StopError

    file = tmp_path / f"run{suffix}"
    file.write_text("before")
    with pytest.raises(StopError):
        write_video(file, MODEL, swing(), view=VIEW, fps=FPS, size=SIZE, watch=stop)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["before"]


def test_a_machine_without_opengl_is_told_so_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("no\ndisplay")

    monkeypatch.setattr(video_screen, "_context", fail)
    for call in (
        lambda: check_video(tmp_path / "run.png"),
        lambda: write_video(tmp_path / "run.png", MODEL, swing(), view=VIEW),
    ):
        with pytest.raises(InputError, match="cannot render: no display; set MUJOCO_GL=egl"):
            call()
    assert not list(tmp_path.iterdir())


def a_record() -> pl.DataFrame:
    """Return the record of a second, in which the sphere goes to the right and pushes up."""
    time, zero = 1e-3 * np.arange(1000), np.zeros(1000)
    push = {"touch.fx": zero, "touch.fy": 20.0 + zero, "touch.fz": zero}
    return pl.DataFrame({"time": time, "q.x": time - 0.5, "q.z": zero, **push})


def a_scene(**given: Any) -> Scene:
    """Return the scene with the force at ``tool``, whose y is up."""
    return Scene(model=MODEL, view=VIEW, **{"forces": {"touch": "tool"}, **given})


def test_the_film_of_a_run_shows_it_with_its_forces(tmp_path: Path) -> None:
    film = partial(film_run, robot=ROBOT, table=a_record(), fps=FPS, size=SIZE)
    seen: list[int] = []
    film(tmp_path / "pushed.png", a_scene(), watch=seen.append)
    film(tmp_path / "free.png", a_scene(forces={}))
    film(tmp_path / "reaction.png", a_scene(scale=-0.02))
    frames, duration = shown(tmp_path / "pushed.png")
    assert seen == list(range(10))
    assert duration == pytest.approx(1.0)
    free, reactions = (shown(tmp_path / f"{name}.png").frames for name in ("free", "reaction"))
    length = FOCAL * 20 * 0.02 / VIEW.distance
    for k, without in enumerate(free):
        for pixels, end in ((frames[k], -length), (reactions[k], length)):
            rows, columns = np.nonzero((pixels != without).any(axis=2))
            where = FOCAL * (k / 10 - 0.5) / VIEW.distance
            assert abs(columns.mean() + 0.5 - SIZE[0] / 2 - where) < A_PIXEL
            far = rows.min() if end < 0 else rows.max() + 1
            assert abs(far - SIZE[1] / 2 - end) < 1.5


def test_forces_that_are_not_known_are_not_drawn() -> None:
    table = a_record().with_columns(
        pl.when(pl.col("time") < 0.5).then(pl.col("touch.fx")).otherwise(np.nan).alias("touch.fx")
    )
    q = np.column_stack([table["q.x"], table["q.z"]])
    arrows = force_arrows(a_scene(), ROBOT, table, q)
    assert [len(some) for some in arrows] == [1] * 500 + [0] * 500
    assert arrows[300][0].point == pytest.approx([-0.2, 0, 0])
    assert arrows[300][0].vector == pytest.approx([0, 0, 20.0])


def test_a_floating_body_is_shown_as_it_is_turned(tmp_path: Path) -> None:
    """A beam of 1 m along x, seen end-on when turned about z; its record has the scalar last."""
    beam = """
    <mujoco><worldbody>
      <light pos="0 -3 3"/>
      <body name="beam">
        <freejoint name="beam"/>
        <geom type="box" size="0.5 0.05 0.2" rgba="0.9 0.1 0.1 1" mass="1"/>
      </body>
    </worldbody></mujoco>
    """
    model = mujoco.MjModel.from_xml_string(beam)
    robot, half = robot_from_mujoco(model), np.sqrt(0.5)
    named = zip(robot.configuration_names, [0.1, 0.0, 0.0, 0.0, 0.0, half, half], strict=True)
    table = pl.DataFrame({"time": [0.0], **{f"q.{name}": [x] for name, x in named}})
    scene = Scene(model=model, view=VIEW, forces={})
    film_run(tmp_path / "film.png", scene, robot, table, fps=FPS, size=SIZE)
    (pixels,) = shown(tmp_path / "film.png").frames
    rows, across = np.nonzero(pixels[..., 0].astype(int) - pixels[..., 2] > 60)
    near = FOCAL / (VIEW.distance - 0.5)
    assert rows.max() + 1 - rows.min() == pytest.approx(0.4 * near, abs=1.5)
    assert across.max() + 1 - SIZE[0] / 2 == pytest.approx(0.15 * near, abs=1.5)


def test_the_film_of_a_run_that_diverges_ends_there(tmp_path: Path) -> None:
    height = pl.when(pl.col("time") < 0.35).then(0.0).otherwise(np.inf)
    table = a_record().with_columns(height.alias("q.z"))
    film_run(tmp_path / "film.png", a_scene(), ROBOT, table, fps=FPS, size=SIZE)
    assert len(shown(tmp_path / "film.png").frames) == 4


def test_a_film_without_a_tick_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="got 0 times"):
        film_run(tmp_path / "a.png", a_scene(), ROBOT, a_record()[:0])


def test_bodies_without_a_joint_move_with_the_record(tmp_path: Path) -> None:
    def places(table: pl.DataFrame) -> dict[str, np.ndarray]:
        poses = np.tile(np.eye(4), (len(table), 1, 1))
        poses[:, 1, 3] = np.where(table["time"] < 0.55, 1.0, -0.5)  # then it hides the sphere
        return {"screen": poses}

    scene = a_scene(forces={}, places=places)
    film_run(tmp_path / "film.png", scene, ROBOT, a_record(), fps=FPS, size=SIZE)
    red = [f[..., 0].astype(int) - f[..., 2] for f in shown(tmp_path / "film.png").frames]
    assert [bool((r > 60).sum() > 100) for r in red] == [True] * 6 + [False] * 4


def test_a_board_is_seen_from_the_side_of_the_robot() -> None:
    x_up_z_ahead = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])
    X_WE = pin.SE3(x_up_z_ahead, np.array([0.6, 0.1, 0.8]))
    view = board_view(X_WE)
    turn, rise = np.radians([view.azimuth, view.elevation])
    ahead = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
    eye = np.array(view.lookat) - view.distance * ahead
    assert X_WE.actInv(eye)[2] < -1.0
    assert np.linalg.norm(np.array(view.lookat)[:2] - X_WE.translation[:2]) < 0.2
