"""Scenes of falling bodies as many cameras film them, drawn apart from the program's own renderer.

A scene has a body's exact motion and a camera of a random look. A pixel is the mean over its area
and over the exposure of a body whose edges the lens blurs by a normal distribution, mixed in light,
so that the truth of each picture is known to a few thousandths of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import av
import numpy as np
from PIL import Image
from scipy import ndimage
from scipy.special import ndtr

GRAVITY = 9.8
LENGTH_MM, WIDTH_MM = 336.5, 2.08
SUB = (-1 / 3, 0.0, 1 / 3)
"""Places in a pixel, of whose values it is the mean."""
INSTANTS = 24


@dataclass(frozen=True)
class Scene:
    """A drop and how it is filmed: lengths in mm and px, levels grey, angles in degrees."""

    seed: int
    body: str
    fps: float
    exposure_s: float
    mm_per_px: float
    height_mm: float
    kept: tuple[float, ...]
    held_s: float
    lean: float = 0.0
    spin: float = 0.0  # degrees per s after the first impact
    roll: float = 0.0
    rolling_s: float = 0.0
    distortion: float = 0.0
    psf_px: float = 0.7
    gamma: float = 1.0
    wall: float = 60.0
    front: float = 190.0
    mottles: float = 3.0
    shadow: float = 0.0
    noise: float = 1.5
    tremor_mm: float = 0.0
    encoding: str = "h264"
    quality: int = 18
    lost: int = 0
    shown_mm: float = 400.0  # of the bristle, from its lower end
    diameter_mm: float = 24.0

    @property
    def whole(self) -> bool:
        return self.body == "ball" or self.shown_mm > LENGTH_MM

    def options(self) -> dict:
        """What a user would tell `track`."""
        told = {"fps": self.fps} if self.encoding == "png" else {}
        if self.body == "ball":
            told |= {"body": "ball", "diameter_mm": self.diameter_mm}
        elif not self.whole:
            told["mm_per_px"] = self.mm_per_px
        if self.rolling_s:
            told["rolling_shutter_s_per_row"] = self.rolling_s
        return told


def drawn_scene(seed: int) -> Scene:
    """A scene of a random look."""
    rng = np.random.default_rng(seed)
    fps = float(rng.choice([25, 30, 60, 100, 120, 240, 480, 1000]))
    ball = rng.random() < 0.2
    slow = fps < 50
    whole = ball or fps < 500
    mm_per_px = float(rng.uniform(0.6, 1.1) if whole else rng.uniform(0.12, 0.3))
    height = float(rng.uniform(120, 250) if ball else rng.uniform(25, 55) if not slow else 50)
    kept = rng.uniform(0.65, 0.9) * np.array([1.0, 0.97, 0.95])
    leans = not ball and rng.random() < 0.4
    lean = float(rng.uniform(-4, 4)) if leans else 0.0
    dark, level = rng.random() < 0.4, rng.uniform(25, 90)
    bright = float(min(level + rng.uniform(40, 160), 235))
    wall, front = (bright, float(level)) if dark else (float(level), bright)
    share = rng.uniform(0.05, 0.9) if not slow else rng.uniform(0.2, 0.9)
    encoding = str(rng.choice(["h264", "h264", "h264", "mjpeg", "png"]))
    phone = rng.random() < 0.3
    return Scene(
        seed=seed,
        body="ball" if ball else "bristle",
        fps=fps,
        exposure_s=float(share / fps),
        mm_per_px=mm_per_px,
        height_mm=height,
        kept=tuple(map(float, kept)),
        held_s=float(rng.uniform(0.1, 0.4) if fps < 500 else rng.uniform(0.02, 0.08)),
        lean=lean,
        spin=float(np.sign(lean) * rng.uniform(0, 15)),
        roll=float(rng.normal(0, 0.6)),
        rolling_s=float(rng.uniform(5e-6, 2e-5)) if phone and fps < 300 else 0.0,
        distortion=float(rng.normal(0, 0.001)),
        psf_px=float(rng.uniform(0.45, 1.2)),
        gamma=float(rng.choice([1.0, 1.0, 2.2])),
        wall=wall,
        front=front,
        mottles=float(rng.uniform(0.5, 6)),
        shadow=float(rng.uniform(0.1, 0.3)) if rng.random() < 0.3 else 0.0,
        noise=float(rng.uniform(0.5, 4)),
        tremor_mm=float(rng.uniform(0.02, 0.2)) if rng.random() < 0.4 else 0.0,
        encoding=encoding,
        quality=int(rng.integers(16, 26)),
        lost=int(rng.integers(0, 3)) if fps > 50 and encoding != "png" else 0,
        shown_mm=LENGTH_MM + 40.0 if whole else float(rng.uniform(45, 90)),
        diameter_mm=float(rng.uniform(14, 30)),
    )


class Motion:
    """Heights (mm) of what the truth follows over the surface: of a bristle the middle of its lower
    end, of a ball its lowest point; and the lean in degrees.

    A bristle turns about its centre of mass after the first impact; the centre flies freely and
    keeps a share of its speed where a corner of the end touches.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, s = scene, scene
        rng = np.random.default_rng([scene.seed, 1])
        self.wave = rng.uniform(0, 2 * np.pi, 3), rng.uniform(2, 6, 3)
        self.release_s = s.held_s
        g = 1e3 * GRAVITY
        self.half = 0.5 * LENGTH_MM if s.body == "bristle" else 0.0
        lean = np.radians(s.lean)
        start = s.height_mm + self.half * np.cos(lean)
        self.flights = [(self.release_s, start, 0.0)]
        self.impact_s: list[float] = []
        for share in s.kept:
            t0, y0, v0 = self.flights[-1]
            t = t0 + np.linspace(1e-6 if not self.impact_s else 2e-3, 1.0, 400_000)
            up = y0 + v0 * (t - t0) - 0.5 * g * (t - t0) ** 2
            self.impact_s.append(float(t[int(np.argmax(up - self.above(t) <= 0.0))]))
            at = self.impact_s[-1]
            v = v0 - g * (at - t0)
            y = y0 + v0 * (at - t0) - 0.5 * g * (at - t0) ** 2
            self.flights.append((at, float(y), -share * v))
        t0, y0, v0 = self.flights[-1]
        self.until_s = t0 + 1.8 * v0 / g

    def above(self, t_s):
        """How high the centre is over the corner that touches."""
        if self.scene.body == "ball":
            return 0.0 * np.asarray(t_s)
        lean = np.radians(self.lean(t_s))
        return self.half * np.cos(lean) + 0.5 * WIDTH_MM * np.abs(np.sin(lean))

    def lean(self, t_s):
        first = self.impact_s[0] if self.impact_s else np.inf
        return self.scene.lean + self.scene.spin * np.maximum(np.asarray(t_s) - first, 0.0)

    def height(self, t_s):
        t_s = np.asarray(t_s, dtype=float)
        y = np.full(t_s.shape, self.flights[0][1])
        for begin, up, speed in self.flights:
            since = np.maximum(t_s - begin, 0.0)
            y = np.where(t_s >= begin, up + speed * since - 0.5e3 * GRAVITY * since**2, y)
        still = np.clip((self.release_s - t_s) / 0.04, 0.0, 1.0)
        phases, rates = self.wave
        tremor = np.sin(2 * np.pi * rates * t_s[..., None] + phases).sum(axis=-1) / np.sqrt(1.5)
        y = y + self.scene.tremor_mm * still * tremor
        return y - (self.half * np.cos(np.radians(self.lean(t_s))) if self.half else 0.0)


def truth_of(scene: Scene, motion: Motion, camera: Camera, film_s) -> dict:
    """What is true of frames that begin at ``film_s``."""
    t = camera.seen_s(film_s)
    half = 0.5 * scene.exposure_s + 2e-4
    crossed = (np.abs(t[:, None] - np.array(motion.impact_s)) < half).any(axis=1)
    dt = 1e-5
    speed = (motion.height(t + dt) - motion.height(t - dt)) / (2 * dt)
    blur = np.abs(speed) * scene.exposure_s / scene.mm_per_px
    row = camera.place(t)[1]
    return {
        "t_s": t, "y_mm": motion.height(t), "lean_deg": motion.lean(t),
        "crossed": crossed, "blur_px": blur, "row": row,
    }  # fmt: skip


class Camera:
    """Where things are in the picture."""

    def __init__(self, scene: Scene, motion: Motion) -> None:
        self.scene, self.motion, s = scene, motion, scene
        high = 1.08 * s.height_mm + (s.shown_mm if s.body == "bristle" else s.diameter_mm + 20.0)
        self.rows = int((high + 16.0) / s.mm_per_px) // 2 * 2
        lean = s.lean + s.spin * max(motion.until_s - motion.impact_s[0], 0.0)
        tilt = max(abs(lean + s.roll), abs(s.lean + s.roll))
        aside = self.rows * np.tan(np.radians(tilt)) if s.body == "bristle" else 0.0
        wide = s.diameter_mm / s.mm_per_px if s.body == "ball" else 0.0
        roll = np.radians(s.roll)
        wide += 90.0 + 2.0 * aside + 2.0 * self.rows * abs(np.sin(roll))
        self.columns = int(wide) // 2 * 2
        rng = np.random.default_rng([s.seed, 2])
        x, y = self.columns / 2 + rng.uniform(-6, 6), rng.uniform(-1, 1)
        self.foot = np.array([x, self.rows - 16.0 / s.mm_per_px + y])
        # anticlockwise in the picture, whose rows count down
        self.up = np.array([-np.sin(roll), -np.cos(roll)])
        self.right = np.array([np.cos(roll), -np.sin(roll)])
        self.centre = 0.5 * np.array([self.columns - 1, self.rows - 1])
        self.corner = float(self.centre @ self.centre)

    def place(self, t_s):
        """Column and row (2, times) of the end."""
        y = np.asarray(self.motion.height(t_s)) / self.scene.mm_per_px
        if self.scene.body == "ball":
            y = y + 0.5 * self.scene.diameter_mm / self.scene.mm_per_px
        straight = self.foot[:, None] + self.up[:, None] * y
        away = straight - self.centre[:, None]
        share = self.scene.distortion * (away**2).sum(axis=0) / self.corner
        return self.centre[:, None] + away * (1 + share)

    def seen_s(self, film_s):
        """Middles of the exposures of the rows in which the end is seen."""
        t = np.asarray(film_s) + 0.5 * self.scene.exposure_s
        base = t
        for _ in range(20):
            t = base + self.scene.rolling_s * self.place(t)[1]
        return t

    def straight(self, x, y):
        """Places in a picture of a perfect lens of those in the picture."""
        p = np.stack([x - self.centre[0], y - self.centre[1]])
        share = self.scene.distortion * (p**2).sum(axis=0) / self.corner
        p = p * (1 - share + 3 * share**2)
        return p[0] + self.centre[0], p[1] + self.centre[1]


def write_scene(path, scene: Scene):
    """Writes the film into the folder ``path``; returns its file and its truth, frame by frame."""
    motion = Motion(scene)
    camera = Camera(scene, motion)
    rng = np.random.default_rng([scene.seed, 3])
    count = int(motion.until_s * scene.fps)
    numbers = np.arange(count)
    if scene.lost:
        numbers = np.setdiff1d(numbers, rng.choice(np.arange(5, count - 5), scene.lost, False))
    film_s = numbers / scene.fps
    pictures = _pictures(scene, motion, camera, film_s, rng)
    truth = truth_of(scene, motion, camera, film_s)
    if scene.encoding == "png":
        file = path / f"s{scene.seed}"
        file.mkdir()
        for k, picture in enumerate(pictures):
            Image.fromarray(picture).save(file / f"{k:05d}.png")
        return file, truth
    file = path / (f"s{scene.seed}.mp4" if scene.encoding == "h264" else f"s{scene.seed}.avi")
    with av.open(str(file), "w") as container:
        if scene.encoding == "h264":
            how = {"crf": str(scene.quality), "preset": "medium", "x264-params": "no-mbtree=1"}
            stream = container.add_stream("libx264", round(scene.fps), how)
            stream.pix_fmt = "yuv420p"
        else:
            stream = container.add_stream("mjpeg", round(scene.fps))
            stream.pix_fmt = "yuvj420p"
            stream.codec_context.qmin = stream.codec_context.qmax = 3
        stream.width, stream.height = camera.columns, camera.rows
        stream.time_base = Fraction(1, round(scene.fps))
        for number, picture in zip(numbers, pictures, strict=True):
            frame = av.VideoFrame.from_ndarray(np.repeat(picture[:, :, None], 3, axis=2), "rgb24")
            frame.pts, frame.time_base = int(number), Fraction(1, round(scene.fps))
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return file, truth


def _pictures(scene, motion, camera, film_s, rng):
    s = scene
    row, column = np.mgrid[: camera.rows, : camera.columns].astype(float)
    coarse = ndimage.gaussian_filter(rng.normal(size=row.shape), rng.uniform(1.5, 6.0))
    wall = s.wall + s.mottles * coarse / coarse.std()
    wall += rng.uniform(-10, 10) * (column / camera.columns - 0.5)
    below = (row - camera.foot[1]) * np.cos(np.radians(s.roll)) > 0.5
    wall = np.where(below, s.wall + 0.3 * (s.front - s.wall), wall)
    wall = np.clip(wall, 1.0, 254.0)
    light = (wall / 255.0) ** s.gamma
    front = (s.front / 255.0) ** s.gamma
    drawn = _Ball(s, camera) if s.body == "ball" else _Bristle(s, camera)
    for begin in film_s:
        share, shade = drawn.shares(motion, float(begin))
        seen = light * (1.0 - s.shadow * shade)
        seen = seen + share * (front - seen)
        if s.body == "bristle" and s.whole:
            _hand(seen, motion, camera, float(begin))
        grey = 255.0 * seen ** (1.0 / s.gamma) + s.noise * rng.normal(size=seen.shape)
        yield np.clip(np.round(grey), 0, 255).astype(np.uint8)


def _hand(light, motion, camera, t_s):
    """Fingers over the upper end, which open as they let go."""
    s = camera.scene
    gone = 2000.0 * max(t_s - motion.release_s, 0.0)
    lean = np.radians(s.lean)
    end = camera.place(np.array([min(t_s, motion.release_s)]))[:, 0]
    axis = np.cos(lean) * camera.up + np.sin(lean) * camera.right
    top = end + axis * (LENGTH_MM - 12.0) / s.mm_per_px
    for side in (-1, 1):
        x = top[0] + side * (gone / s.mm_per_px)
        a, b = sorted((x, x + side * 30.0))
        r = slice(max(int(top[1] - 12), 0), max(int(top[1] + 12), 0))
        c = slice(max(int(a), 0), max(int(b), 0))
        light[r, c] = ((s.wall + 0.6 * (s.front - s.wall)) / 255.0) ** s.gamma


class _Bristle:
    """A rectangle; along the axis its ends are means over the exposure."""

    def __init__(self, scene, camera):
        self.scene, self.camera = scene, camera

    def shares(self, motion, film_s):
        s, c = self.scene, self.camera
        when = c.seen_s(np.array([film_s]))
        t = float(when[0])
        end = c.place(when)[:, 0]
        x0, y0 = c.straight(*end)
        lean = np.radians(float(motion.lean(t)))
        axis = np.cos(lean) * c.up + np.sin(lean) * c.right
        normal = np.array([-axis[1], axis[0]])
        half, long = 0.5 * WIDTH_MM / s.mm_per_px, LENGTH_MM / s.mm_per_px
        u = s.exposure_s * ((np.arange(INSTANTS) + 0.5) / INSTANTS - 0.5)
        # each row begins its exposure later; the end is seen at `t`
        rows = np.arange(c.rows)
        later = s.rolling_s * (rows - end[1])
        knots = np.unique(np.concatenate([np.linspace(later[0], later[-1], 9), [0.0]]))
        moved = motion.height(t + knots[:, None] + u) - motion.height(t)
        moved *= np.cos(lean) / s.mm_per_px
        reach = np.abs(moved).max() + 8.0
        grid = np.arange(-reach, reach, 0.02)
        share, shade = np.zeros((c.rows, c.columns)), np.zeros((c.rows, c.columns))
        tip = np.stack([ndtr((grid[None, :] - m[:, None]) / s.psf_px).mean(axis=0) for m in moved])
        which = np.argmin(np.abs(later[:, None] - knots), axis=1)
        top = (x0 + axis[0] * long, y0 + axis[1] * long)
        left = max(int(min(x0, top[0]) - half - 8), 0)
        right = min(int(max(x0, top[0]) + half + 9), c.columns)
        r, k = np.mgrid[: c.rows, left:right].astype(float)
        for dy in SUB:
            for dx in SUB:
                x, y = c.straight(k + dx, r + dy)
                along = (x - x0) * axis[0] + (y - y0) * axis[1]
                aside = (x - x0) * normal[0] + (y - y0) * normal[1]
                wide = ndtr((aside + half) / s.psf_px) - ndtr((aside - half) / s.psf_px)
                lower, upper = np.empty_like(along), np.empty_like(along)
                for w in np.unique(which):
                    m = which == w
                    lower[m] = np.interp(along[m], grid, tip[w])
                    upper[m] = np.interp(along[m] - long, grid, tip[w])
                share[:, left:right] += wide * (lower - upper) / 9.0
        if s.shadow:
            soft = ndimage.gaussian_filter(share, 2.0)
            shade = np.roll(np.roll(soft, 9, axis=1), 5, axis=0)
        return share, shade


class _Ball:
    """A disc whose brightness is even."""

    def __init__(self, scene, camera):
        self.scene, self.camera = scene, camera

    def shares(self, motion, film_s):
        s, c = self.scene, self.camera
        t = float(c.seen_s(np.array([film_s]))[0])
        u = s.exposure_s * ((np.arange(INSTANTS) + 0.5) / INSTANTS - 0.5)
        places = c.place(t + u)
        radius = 0.5 * s.diameter_mm / s.mm_per_px
        share = np.zeros((c.rows, c.columns))
        low = max(int(places[1].min() - radius - 6), 0)
        high = min(int(places[1].max() + radius + 7), c.rows)
        left = max(int(places[0].min() - radius - 6), 0)
        right = min(int(places[0].max() + radius + 7), c.columns)
        r, k = np.mgrid[low:high, left:right].astype(float)
        for dy in SUB:
            for dx in SUB:
                away = np.hypot(k[..., None] + dx - places[0], r[..., None] + dy - places[1])
                share[low:high, left:right] += ndtr((radius - away) / s.psf_px).mean(axis=-1) / 9.0
        shade = np.zeros_like(share)
        if s.shadow:
            shade = np.roll(ndimage.gaussian_filter(share, 2.0), 9, axis=1)
        return share, shade
