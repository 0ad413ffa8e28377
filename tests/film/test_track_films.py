"""Films into tracks: films drawn by a program of its own, and one that another program drew."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pandas as pd
import pytest
from film_scenes import LENGTH_MM, drawn_scene, write_scene
from PIL import Image
from scipy import ndimage

import bristle
from bristle.solver.errors import InputError
from bristle.studies.film.edge import Camera
from bristle.studies.film.reading import Film, _places
from bristle.studies.film.render import Flown, Look, bouncing, write_film
from bristle.studies.film.scale import floor_of, gravity_px, scale_of, touching_px, weighed
from bristle.studies.film.scan import scan
from bristle.studies.film.tracker import Expected, tracked
from bristle.studies.inputs.choices import Body, Down
from bristle.studies.loop.kinds.tracks.record import read_tracks

pytestmark = pytest.mark.serial
ROOT = Path(__file__).parents[2]
FOUR = ROOT / "docs" / "gallery" / "data" / "four-drops.mp4"
# Of FOUR, as its renderer has them: instants of release (s), heights (mm), speed kept.
RELEASES = (0.25, 1.121473, 2.045186, 2.979366)
HEIGHTS = (41.0, 28.5, 48.2, 19.3)
KEPT = (0.75, 0.77, 0.74, 0.79)
G, CONTACT_S = 9.8, 3e-4
# What the issue of a film asks of ends that are sharp, and of those that are drawn long.
SHARP_PX, BLURRED_PX = 0.15, 0.5


def filmed(folder, look=None, lean=0.0, y0=0.03, y1=0.018, seed=1, **motion):
    """A film, and the true heights at the middles of exposures."""
    look = look or Look()
    height, until = bouncing(y0, y1, CONTACT_S, G, **motion)
    path = folder / f"film-{seed}.mp4"
    times = write_film(path, Flown(height, until, lean), look, np.random.default_rng(seed))
    return path, height, times


@pytest.fixture(scope="module")
def four():
    return tracked(Film(FOUR), Body.BRISTLE)


def test_four_drops_of_one_film_are_told_apart(four):
    assert len(four.drops) == 4
    assert [d.release_s for d in four.drops] == pytest.approx(RELEASES, abs=0.004)
    for drop, kept in zip(four.drops, KEPT, strict=True):
        assert abs(drop.restitution[0] - kept) < max(0.005, 2.6 * drop.restitution_error[0])


def test_a_hand_that_lifts_a_bristle_is_no_fall_upward():
    with pytest.raises(InputError, match="no bristle that falls"):
        tracked(Film(FOUR, down=Down.UP), Body.BRISTLE, expected=Expected(length_mm=336.5))


def test_the_body_s_length_gives_the_scale_and_gravity_agrees(four):
    scale = scale_of(four, 336.5, None)
    assert scale.mm_per_px == pytest.approx(1.09, rel=2.6 * scale.error)
    g_px, error = gravity_px(four)
    assert 1e-3 * scale.mm_per_px * g_px == pytest.approx(G, rel=2.6 * np.hypot(error, scale.error))
    floor, _ = floor_of(four.drops)
    tops = [scale.mm_per_px * (drop.held - floor) for drop in four.drops]
    assert tops == pytest.approx(HEIGHTS, abs=0.25)


@pytest.mark.parametrize(
    "look",
    [
        Look(),
        Look(wall=150.0, bristle=35.0, mottles=6.0, noise=3.0, crf=23),
        Look(mm_per_px=1.0, columns=96, noise=2.5),
    ],
    ids=["bright", "dark on a mottled wall", "coarse"],
)
def test_ends_are_found_and_their_errors_hold_up(tmp_path, look):
    path, height, times = filmed(tmp_path, look)
    found = tracked(Film(path), Body.BRISTLE)
    assert len(found.drops) == 1
    used = found.used(found.drops[0])
    assert len(used) > 60
    true = 1e3 * height(times[found.number[used]]) / look.mm_per_px
    error = -found.down[used] - true
    error -= np.median(error)  # the surface's row in the picture is not the tracker's to know
    assert np.sqrt(np.mean(error**2)) < SHARP_PX
    kept = np.sqrt(0.018 / 0.03)
    found, scale = weighed(found, scale_of(found, 336.5, None), G, 336.5)
    drop = found.drops[0]
    used = found.used(drop)
    floor, floor_error = floor_of(found.drops)
    up = -found.down[used] - floor
    # flights meet lower than the surface for as long as the body touches
    zero = np.hypot(floor_error, touching_px(found.drops))
    total = np.sqrt(found.sigma[used] ** 2 + zero**2 + (scale.error * up) ** 2)
    error = scale.mm_per_px * up - 1e3 * height(times[found.number[used]])
    # of so few frames, whose errors are alike from one to the next, no more can be asked
    assert np.mean(np.abs(error) < 1.645 * scale.mm_per_px * total) > 0.8
    assert drop.restitution[0] == pytest.approx(
        kept, abs=max(0.005, 2.6 * drop.restitution_error[0])
    )


def test_an_end_that_is_drawn_long_is_where_it_is_at_mid_exposure(tmp_path):
    look = Look(fps=30.0, exposure_s=0.02, mm_per_px=0.7, wall=150.0, bristle=30.0)
    path, height, times = filmed(tmp_path, look, y0=0.05, y1=0.04, held_s=0.3)
    found = tracked(Film(path), Body.BRISTLE)
    used = found.used(found.drops[0])
    t = times[found.number[used]]
    speed = np.abs(height(t + 1e-4) - height(t - 1e-4)) / 2e-4
    blurred = 1e3 * speed * look.exposure_s / look.mm_per_px > 10.0
    assert blurred.sum() >= 3
    error = -found.down[used] - 1e3 * height(t) / look.mm_per_px
    error -= np.median(error[~blurred])
    assert np.sqrt(np.mean(error[blurred] ** 2)) < BLURRED_PX
    assert found.camera.exposure_s == pytest.approx(look.exposure_s, rel=0.1)


@pytest.mark.parametrize("lean", [-3.0, 2.0])
def test_lean_is_seen_to_a_tenth_of_a_degree(tmp_path, lean):
    path, *_ = filmed(tmp_path, lean=lean)
    found = tracked(Film(path), Body.BRISTLE)
    seen = np.degrees(found.turn[found.used(found.drops[0])])
    assert np.abs(seen - lean).max() < 0.1


def test_heights_count_from_where_a_corner_of_the_end_touches(tmp_path):
    """From film to dataset to loop: the middle of the end is above the surface then."""
    films = [filmed(tmp_path, lean=5.0, seed=seed)[0] for seed in range(4)]
    bristle.track(films, out=tmp_path / "seen")
    table = pd.read_csv(tmp_path / "seen" / "tracks.csv")
    data = read_tracks(tmp_path / "seen")
    held = np.array([1e3 * data.value[each.start] for each in data.pieces])
    # flights before and after cross where the bristle would be, did the touch take no time
    before, after = np.sqrt(2e3 * G * np.array([30.0, 18.0]))
    crossing = CONTACT_S * before * after / (before + after)
    error = float(data.manifest.measurement["sigma_surface_mm"]) / np.sqrt(len(held))
    assert np.mean(held) == pytest.approx(30.0 + crossing, abs=2.6 * error)
    assert table.y_mm.to_numpy() - 1e3 * data.value == pytest.approx(Look().corner_mm(5.0), rel=0.1)


def drawn_ball(folder, fps=120.0, aside_px_s=0.0, shade=0.0, shake_px=0.0):
    """Pictures of a ball that falls 150 mm and bounces, drawn here; it may go to the side. A share
    ``shade`` of its light comes from above on the left, and is scattered evenly (Lambert)."""
    radius, scale = 9.3, 1.0
    height, until = bouncing(0.15, 0.1, 1e-3, G, held_s=0.1, bounces=1)
    rng = np.random.default_rng(4)
    shake = shake_px * ndimage.gaussian_filter1d(np.random.default_rng(3).normal(size=400), 3.0)
    shake /= 0.31  # of a unit's noise so smooth
    row, column = np.mgrid[:260, :90].astype(float)
    for k, t in enumerate(np.arange(0.0, until, 1.0 / fps)):
        y = 230.0 - 1e3 * float(height(t)) / scale - radius
        right, down = column - 41.4 - aside_px_s * max(t - 0.1, 0.0) - shake[k], row - y
        away = np.hypot(right, down)
        faces = np.sqrt(np.maximum(1.0 - (away / radius) ** 2, 0.0))
        lit = np.maximum(0.7 * faces - (0.4 * right + 0.6 * down) / radius, 0.0) / 0.7
        light = 190.0 * (1.0 - shade + shade * lit) - 60.0
        picture = 60.0 + light * np.clip(radius - away + 0.5, 0.0, 1.0)
        picture += rng.normal(size=row.shape)
        Image.fromarray(np.clip(picture, 0, 255).astype(np.uint8)).save(folder / f"{k:04d}.png")
    return folder, fps


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    return drawn_ball(tmp_path_factory.mktemp("ball"))


@pytest.fixture(scope="module")
def whole(ball):
    folder, fps = ball
    return tracked(Film(folder, fps=fps), Body.BALL)


def test_a_ball_in_a_folder_of_pictures(whole):
    (drop,) = whole.drops
    assert drop.restitution[0] == pytest.approx(np.sqrt(0.1 / 0.15), abs=0.005)
    assert scale_of(whole, 18.6, None).mm_per_px == pytest.approx(1.0, rel=0.02)
    assert gravity_px(whole)[0] == pytest.approx(1e3 * G, rel=0.005)


def test_a_ball_lit_from_one_side_is_as_large(tmp_path, whole):
    folder, fps = drawn_ball(tmp_path, shade=0.4)
    lit = tracked(Film(folder, fps=fps), Body.BALL)
    assert np.median(lit.length) == pytest.approx(np.median(whole.length), rel=0.01)


def test_what_goes_to_the_side_does_not_turn_the_vertical(tmp_path, whole):
    folder, fps = drawn_ball(tmp_path, aside_px_s=60.0)
    found = tracked(Film(folder, fps=fps), Body.BALL)
    assert abs(found.vertical[0]) < 2.6 * found.vertical[1] < np.radians(0.5)
    tops = [track.drops[0].held - track.drops[0].floor for track in (found, whole)]
    assert tops[0] == pytest.approx(tops[1], abs=SHARP_PX)


def test_a_camera_that_shakes_is_less_sure_of_the_vertical(tmp_path):
    folder, fps = drawn_ball(tmp_path, shake_px=0.3)
    found = tracked(Film(folder, fps=fps), Body.BALL)
    assert abs(found.vertical[0]) < 2.6 * found.vertical[1]
    # neighbours that err alike tell less than as many that do not, which would be sure to 0.001
    assert found.vertical[1] > 0.003


def test_samples_of_a_film_lie_evenly_over_what_moves(tmp_path):
    folder, fps = drawn_ball(tmp_path, fps=480.0)
    number = scan(Film(folder, fps=fps)).number
    assert len(number) > 16
    moving = np.diff(number[number > 0.1 * fps])
    assert moving.max() < 2.0 * moving.min()


def test_a_shadow_beside_a_ball_does_not_make_it_larger(tmp_path, ball, whole):
    folder, fps = ball
    for path in sorted(folder.iterdir()):
        with Image.open(path) as picture:
            grey = np.asarray(picture).astype(float)
        light = ndimage.gaussian_filter(np.clip((grey - 60.0) / 130.0, 0.0, 1.0), 2.0)
        shade = np.roll(light, 9, axis=1) * (grey < 100.0)
        Image.fromarray((grey - 20.0 * shade).astype(np.uint8)).save(tmp_path / path.name)
    shaded = tracked(Film(tmp_path, fps=fps), Body.BALL)
    assert np.median(shaded.length) == pytest.approx(np.median(whole.length), rel=0.005)


def test_a_gamma_does_not_make_a_soft_ball_larger(tmp_path):
    scene = drawn_scene(5010)
    assert scene.gamma > 2.0
    assert scene.psf_px > 1.0
    file, _ = write_scene(tmp_path, scene)
    scale = scale_of(tracked(Film(file), Body.BALL), scene.diameter_mm, None)
    assert scale.error < 0.015
    assert scale.mm_per_px == pytest.approx(scene.mm_per_px, rel=2.0 * scale.error)


def test_a_rolling_shutter_does_not_make_a_bristle_longer(tmp_path):
    scene = replace(drawn_scene(5), rolling_s=2e-5, encoding="png", fps=120.0, exposure_s=1e-3)
    file, _ = write_scene(tmp_path, scene)
    camera = Camera(rolling_s=scene.rolling_s)
    found = tracked(Film(file, fps=scene.fps, down=Down.DOWN), Body.BRISTLE, camera)
    off = found.length[np.isfinite(found.length)] - LENGTH_MM / scene.mm_per_px
    # beside an impact one end is seen before it and the other after
    assert np.percentile(np.abs(off), 75) < 0.7


def test_a_film_turned_on_its_side_is_read_all_the_same(tmp_path, ball):
    folder, fps = ball
    for path in folder.iterdir():
        with Image.open(path) as picture:
            narrow = picture.crop((20, 0, 65, picture.height))
            narrow.transpose(Image.Transpose.ROTATE_90).save(tmp_path / path.name)
    found = tracked(Film(tmp_path, fps=fps, down=Down.AUTO), Body.BALL)
    assert found.film.down is Down.RIGHT
    used = found.used(found.drops[0])
    x, y = found.film.shown(found.column, found.row, found.shape)
    # what falls 150 px moves to the right in the picture as it is shown
    assert np.ptp(x[used]) == pytest.approx(150.0, abs=5.0)
    assert np.ptp(y[used]) < 1.0


@pytest.mark.parametrize("rows", [230, 214])
def test_a_part_of_the_picture(ball, whole, rows):
    """Also one that ends 4 px below the surface."""
    folder, fps = ball
    part = tracked(Film(folder, fps=fps, roi=(10, 20, 70, rows)), Body.BALL)
    x, y = part.film.shown(part.column, part.row, part.shape)
    assert np.median(x) == pytest.approx(np.median(whole.column), abs=0.05)
    assert y.max() == pytest.approx(whole.row.max(), abs=0.05)


def _still(folder):
    height, _ = bouncing(0.02, 1e-4, CONTACT_S, G, held_s=1.0)
    path = folder / "still.mp4"  # before the release nothing moves
    write_film(path, Flown(height, 0.25), Look(), np.random.default_rng(1))
    return path


def _moving_hand(folder):
    rng = np.random.default_rng(0)
    frames = [60.0 + rng.normal(size=(200, 80)) for _ in range(40)]
    for k, frame in enumerate(frames):
        frame[40 + k : 80 + k, 20:60] += 90.0  # a block, which is neither thin nor falls
    return _pictures(folder / "hand", frames)


def _carried(folder):
    # a strip that is lowered at a steady speed
    frames = []
    for k in range(60):
        frame = np.full((300, 80), 60.0)
        frame[: 100 + 2 * k, 38:42] = 180.0
        frames.append(frame)
    return _pictures(folder / "carried", frames)


def _pictures(folder, frames):
    folder.mkdir()
    for k, frame in enumerate(frames):
        Image.fromarray(np.clip(frame, 0, 255).astype(np.uint8)).save(folder / f"{k:03d}.png")
    return folder


@pytest.mark.parametrize("make", [_still, _moving_hand, _carried])
def test_a_film_without_a_body_that_falls_is_refused(tmp_path, make):
    pictures = make(tmp_path)
    for body in Body:
        with pytest.raises(InputError, match=f"no {body} that falls.*Looked for was"):
            tracked(Film(pictures, fps=100.0, down=Down.DOWN), body)


def test_files_that_are_no_films(tmp_path):
    text = tmp_path / "film.mp4"
    text.write_text("no film")
    with pytest.raises(InputError, match="cannot be read as a film"):
        list(Film(text).frames())
    with pytest.raises(InputError, match="no such film"):
        list(Film(tmp_path / "none.mp4").frames())
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="no pictures in this folder"):
        list(Film(empty).frames())
    Image.fromarray(np.zeros((40, 40), np.uint8)).save(empty / "1.png")
    with pytest.raises(InputError, match="needs --fps"):
        list(Film(empty).frames())
    with pytest.raises(InputError, match="lies outside the picture"):
        list(Film(empty, fps=10.0, roi=(30, 0, 20, 20)).frames())


def test_a_film_that_is_cut_off_ends_where_it_does(tmp_path):
    whole = sum(1 for _ in Film(FOUR).frames())
    remuxed = tmp_path / "whole.ts"
    # a stream as it is broadcast can be read up to where it is cut
    with av.open(str(FOUR)) as source, av.open(str(remuxed), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                target.mux(packet)
    cut = tmp_path / "cut.ts"
    cut.write_bytes(remuxed.read_bytes()[: remuxed.stat().st_size // 2])
    film = Film(cut)
    assert 10 < sum(1 for _ in film.frames()) < whole


@pytest.mark.parametrize("share", [0.3, 0.9])
def test_a_film_that_is_cut_off_says_where_it_ends(share, tmp_path):
    content, path, told = FOUR.read_bytes(), tmp_path / "cut.mp4", []
    path.write_bytes(content[: int(share * len(content))])
    count = sum(1 for _ in Film(path).frames(told.append))
    assert 10 < count < 470
    assert told == [f"cut.mp4: is damaged after frame {count - 1}, where it ends"]


def test_a_folder_may_hold_pictures_of_both_depths(tmp_path):
    """White is that of the deep ones, wherever they come."""
    for number in range(4):
        deep = np.full((40, 40), 20_000 + 15_000 * number, np.uint16)
        bright = deep if number in (1, 2) else np.full((40, 40), 7, np.uint8)
        Image.fromarray(bright).save(tmp_path / f"{number}.png")
    greys = [int(frame.grey[0, 0]) for frame in Film(tmp_path, fps=10.0).frames()]
    assert greys == pytest.approx([7, 255 * 35_000 / 65_535, 255 * 50_000 / 65_535, 7], abs=1)


@pytest.mark.parametrize(
    ("names", "places"),
    [
        (["f8", "f9", "f11"], [0, 1, 3]),
        (["20261129164732123450", "20261129164732123451"], [0, 1]),
        (["f0", "f0", "f1", "f1"], [0, 1, 2, 3]),
        (["a1b1", "a2b7"], [0, 1]),
    ],
)
def test_numbers_in_names_tell_which_pictures_are_missing(names, places):
    """Of any length; not where they come twice, or where it is not one number that counts."""
    assert _places([Path(f"{name}.png") for name in names]) == places


def test_what_is_damaged_of_a_film_is_left_out(tmp_path):
    """Up to the next picture that stands alone; the rest keeps its numbers and its times."""
    short = tmp_path / "short.mp4"
    with av.open(str(short), "w") as target:
        stream = target.add_stream("libx264", 120, {"g": "20", "crf": "18"})
        stream.width, stream.height, stream.pix_fmt = 64, 128, "yuv420p"
        for k in range(100):
            grey = np.full((128, 64, 3), 60, np.uint8)
            grey[: 20 + k, 30:34] = 180
            target.mux(stream.encode(av.VideoFrame.from_ndarray(grey, "rgb24")))
        target.mux(stream.encode())
    whole = list(Film(short).frames())
    content = bytearray(short.read_bytes())
    begin = content.index(b"mdat") + 4
    middle = begin + (content.index(b"moov", begin) - begin) // 2
    content[middle : middle + 8] = bytes(8)
    path = tmp_path / "hurt.mp4"
    path.write_bytes(content)
    told = []
    left = list(Film(path).frames(told.append))
    missing = sorted({each.number for each in whole} - {each.number for each in left})
    assert 0 < len(missing) < 21
    words = f"{len(missing)} picture{'s are' if len(missing) > 1 else ' is'} left out"
    assert told == [f"hurt.mp4: is damaged, first at frame {missing[0]}; {words}"]
    for each in left:
        assert each.t_s == whole[each.number].t_s
        assert np.array_equal(each.grey, whole[each.number].grey)


def _made(path, options, square="1:1", rate=25):
    """A film of six pictures, 64 by 48."""
    with av.open(str(path), "w") as target:
        stream = target.add_stream("libx264", rate, options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(square.replace(":", "/"))
        for _ in range(6):
            grey = np.full((48, 64, 3), 90, np.uint8)
            target.mux(stream.encode(av.VideoFrame.from_ndarray(grey, "rgb24")))
        target.mux(stream.encode())
    return Film(path)


def test_an_even_rate_that_a_container_rounds_is_even(tmp_path):
    # to milliseconds
    steps = np.diff([each.t_s for each in _made(tmp_path / "short.mkv", {}, rate=240).frames()])
    assert steps == pytest.approx(1.0 / 240.0, rel=1e-6)


def test_pixels_that_are_not_square_are_made_so(tmp_path):
    first = next(_made(tmp_path / "wide.mp4", {}, square="4:3").frames())
    assert first.grey.shape == (48, 85)


def test_an_interlaced_film_says_so(tmp_path):
    told = []
    list(_made(tmp_path / "old.mp4", {"x264-params": "tff=1"}).frames(told.append))
    list(_made(tmp_path / "new.mp4", {}).frames(told.append))
    assert len(told) == 1
    assert told[0].startswith("old.mp4: is interlaced")


def test_a_picture_that_is_missing_leaves_its_time_free(tmp_path):
    for number in (10, 11, 12, 14, 15, 18):
        Image.fromarray(np.zeros((40, 40), np.uint8)).save(tmp_path / f"shot2-{number}.png")
    (tmp_path / "._shot2-10.png").write_bytes(b"what a Mac leaves on other disks")
    times = [frame.t_s for frame in Film(tmp_path, fps=10.0).frames()]
    assert times == pytest.approx([0.0, 0.1, 0.2, 0.4, 0.5, 0.8])


def test_a_deep_picture_may_be_brighter_than_the_first(tmp_path):
    for number, bright in enumerate((900, 40_000)):
        deep = np.full((40, 40), 800, np.uint16)
        deep[10:20] = bright
        Image.fromarray(deep).save(tmp_path / f"{number}.png")
    dark, late = [frame.grey for frame in Film(tmp_path, fps=10.0).frames()]
    assert int(late.max()) == pytest.approx(255 * 40_000 / 65_535, abs=1)
    assert dark[0, 0] == late[0, 0]


def test_pictures_of_twelve_bits(tmp_path, ball):
    folder, fps = ball
    for path in folder.iterdir():
        with Image.open(path) as picture:
            deep = np.asarray(picture).astype(np.uint16) * 16
            Image.fromarray(deep).save(tmp_path / path.name)
    eight = [frame.grey for frame in Film(folder, fps=fps).frames()]
    twelve = [frame.grey for frame in Film(tmp_path, fps=fps).frames()]
    assert np.abs(np.array(eight, int) - np.array(twelve, int)).max() <= 1


def test_an_exposure_is_not_longer_than_from_frame_to_frame(ball):
    folder, fps = ball
    given = Camera(exposure_s=0.1, exposure_known=True)
    with pytest.raises(InputError, match="--exposure-s of 0.1 s is longer"):
        tracked(Film(folder, fps=fps), Body.BALL, given)
