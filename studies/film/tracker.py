"""The track of a body through a film: where its lower end is in every frame of every drop.

The first reading of the film finds the body, the second follows it. All that comes after works on
the few grey levels about its ends: drops, the camera's exposure, and the ends once more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...solver.arrays import Array
from ...solver.errors import InputError
from ..inputs.choices import Body, Down
from .disc import discs, find_ball
from .edge import Camera, Ends, camera_of, edges, edges_of, instants
from .flights import TURNED, Drop, Track, drops_of, is_about, settled, spread_of
from .follow import Follower, Sight
from .reading import TURNS, Film
from .scan import Scan, scan
from .strip import find_strip

FIRST_SIGMA_PX = 0.3
"""Of the first guess of an end, which counts whole pixels."""
LEAST_SIGMA_PX = 0.02
DISC_SIGMA_PX = 0.05
"""Of a disc's centre, since no ball is as bright as a linear function across."""
BALL_TURNED = 1e-3
"""By what share a ball's flights differ in acceleration: it does not matter that it turns."""
CHAIN_PX = 0.25
"""What is added to errors where flights are looked for: an end may stray for a frame."""
MISTAKEN = 5.0
"""Standard errors beyond which a frame of a flight is a mistake."""
PHONE_GAMMA = 2.2
LEVEL = float(np.radians(0.5))
"""How level a camera is that somebody set up by eye."""
LEAST_FREEDOM = 3
"""How many more frames than numbers are needed to know how far columns scatter."""
LEAST_STREAK_PX, MOST_OFF_PX, STREAK_SIGMA_PX = 6.0, 3.0, 0.15
"""An end drawn longer than that by an impact is compared with its path; one farther from it than
that is not it; and by how much the shape of a path is unsure."""
GAMMA_FELT_PX = 3.0
"""An end that moves more in an exposure lies elsewhere for another gamma."""


@dataclass(frozen=True)
class Tracked:
    """What is seen of a body in a film, in the frames in which it is seen.

    All arrays are (frames,). ``number`` and ``t_s`` are frames and the middles of their exposures
    in s. ``column`` and ``row`` say where the lower end (of a ball: its lowest point) is in the
    turned picture, ``down`` how far along the vertical, in px, and ``sigma`` its standard error.
    ``turn`` is by how much a bristle leans from the vertical, its upper end to the right, in
    radians, and ``sigma_turn`` its standard error. ``length`` is that of the body in px where it is
    seen whole, ``length_error`` what it may err by in all frames alike, and ``width`` about that of
    a bristle. ``vertical`` is the vertical's slope in columns a row, with its standard error.
    ``damage`` are those of `scan.Scan`. In the frames whose numbers are in ``through`` an impact
    lies in the exposure, and ``down`` is a mean.
    """

    film: Film
    body: Body
    shape: tuple[int, int]
    frame_s: float
    frames: int
    camera: Camera
    number: NDArray[np.int64]
    t_s: Array
    column: Array
    row: Array
    down: Array
    sigma: Array
    turn: Array | None
    sigma_turn: Array | None
    length: Array
    width: float
    vertical: tuple[float, float]
    drops: Sequence[Drop]
    damage: tuple[str, ...]
    through: NDArray[np.int64]
    length_error: float = 0.0

    @property
    def track(self) -> Track:
        """Heights along the vertical over time."""
        return Track(self.t_s, -self.down, self.sigma, self.camera.exposure_s, self.through)

    @property
    def fallen(self) -> int:
        """In how many frames it flies freely."""
        flying = [drop.phase(self.t_s[self.used(drop)]) >= 0 for drop in self.drops]
        return int(sum(each.sum() for each in flying))

    def used(self, drop: Drop) -> NDArray[np.int64]:
        """The frames of a drop that can be relied on: no impact blurs them, none is mistaken."""
        own = self.track.clear(drop)
        off = np.abs(-self.down[own] - drop.height(self.t_s[own]))
        good = off < MISTAKEN * self.sigma[own] + 0.3
        if drop.release_s is not None:
            good |= np.abs(self.t_s[own] - drop.release_s) < self.frame_s
        return own[good]

    def residual(self, drop: Drop) -> Array:
        """Heights less those of the drop's parabolas in px, in the frames (frames,) used."""
        used = self.used(drop)
        return np.asarray(-self.down[used] - drop.height(self.t_s[used]))


@dataclass(frozen=True)
class Expected:
    """What is known of a film's falls: gravity in mm/s², and the body's length or a pixel in mm."""

    gravity_mm_s2: float = 9800.0
    length_mm: float | None = None
    mm_per_px: float | None = None

    def gravity_px(self, length: Array) -> float | None:
        """About gravity in px/s², where the body seems to be so long in frames (frames,)."""
        px = length[np.isfinite(length)]
        if self.mm_per_px is not None:
            return self.gravity_mm_s2 / self.mm_per_px
        if self.length_mm is None or not len(px):
            return None
        # a hand hides a part in many frames
        return self.gravity_mm_s2 * float(np.percentile(px, 80)) / self.length_mm


def tracked(
    film: Film,
    body: Body,
    given: Camera | None = None,
    expected: Expected | None = None,
) -> Tracked:
    """Track a film. ``given`` is what is known of its camera.

    Raises InputError where no body is seen to fall, in a way that says what was looked for.
    """
    given, expected = given or Camera(), expected or Expected()
    ways = list(TURNS) if film.down is Down.AUTO else [film.down]
    doubt, results = "", []
    for down in ways:
        turned = replace(film, down=down)
        seen = scan(turned)
        longest = float(np.max(np.diff(seen.t_s)))
        if given.exposure_s > longest:
            raise InputError(
                f"{film.path}: --exposure-s of {given.exposure_s:g} s is longer than from a frame "
                f"to the next, {longest:.4g} s"
            )
        found = _bristle(turned, seen) if body is Body.BRISTLE else _ball(turned, seen)
        if isinstance(found, str):
            doubt = doubt or found
            continue
        result = _settle(turned, body, seen, found, given, expected)
        gravity = expected.gravity_px(result.length)
        bounced = [drop.gravity for drop in result.drops if len(drop.impact_s)]
        known = gravity is not None and any(is_about(each, gravity) for each in bounced)
        if known or result.fallen > 0.5 * result.frames:
            return result
        results.append(result)
    # what else moves, or a hand that moves the body, is rarely like a fall for as long
    best = max(results, key=lambda each: each.fallen, default=None)
    if best is not None and best.fallen:
        return best
    if results:
        most = max(len(each.t_s) for each in results)
        doubt = (
            f"a {body} is in view in {most} of {results[0].frames} frames, but it never falls "
            "freely for long enough; three frames with a known scale are the least"
        )
    looked = {
        Body.BRISTLE: "a thin straight strip, nearly upright, whose lower end moves",
        Body.BALL: "a disc that moves and touches no border of the picture",
    }[body]
    raise InputError(
        f"{film.path}: no {body} that falls: {doubt}. Looked for was {looked}. Show where it is by "
        "--roi, which way is down by --down, or choose --body"
    )


@dataclass(frozen=True)
class _Seen:
    """The raw sights of a film, what `_settle` makes a track of: of each frame where the lower end
    is, its standard error, the slope of the axis, and the body's length, in px, which is not a
    number where an end is hidden. ``sights`` are those of a bristle, ``blur`` (frames,) by how much
    a ball is drawn long, ``length_error`` what lengths may err by alike, in px."""

    number: NDArray[np.int64]
    t_s: Array
    row: Array
    column: Array
    sigma: Array
    slope: Array
    length: Array
    sights: Sequence[Sight] = ()
    blur: Array | None = None
    length_error: float = 0.0


def _bristle(film: Film, seen: Scan) -> _Seen | str:
    found = find_strip(seen)
    if found is None:
        return "nothing of that shape moves"
    sights = Follower(*found).sights(film.frames())
    if len(sights) < 6:
        return f"it is in view in {len(sights)} frames"
    row = np.array([each.tip.row for each in sights])
    slope = np.array([each.slope for each in sights])
    tops = np.array([np.nan if each.top is None else each.top.row for each in sights])
    return _Seen(
        number=np.array([each.number for each in sights]),
        t_s=np.array([each.t_s for each in sights]),
        row=row,
        column=np.array([each.column for each in sights]) + slope * row,
        sigma=np.full(len(row), FIRST_SIGMA_PX),
        slope=slope,
        length=row - tops,
        sights=sights,
    )


def _ball(film: Film, seen: Scan) -> _Seen | str:
    ball = find_ball(seen)
    if ball is None:
        return "nothing of that shape moves"
    found = discs(film.frames(), ball)
    if len(found) < 6:
        return f"it is in view in {len(found)} frames"
    return _Seen(
        number=np.array([each.number for each in found]),
        t_s=np.array([each.t_s for each in found]),
        row=np.array([each.row + each.radius for each in found]),
        column=np.array([each.column for each in found]),
        sigma=np.array([np.hypot(each.sigma, DISC_SIGMA_PX) for each in found]),
        slope=np.zeros(len(found)),
        length=np.array([2.0 * each.radius for each in found]),
        blur=np.array([each.length for each in found]),
        length_error=2.0 * ball.radius_error,
    )


def _settle(
    film: Film, body: Body, seen: Scan, raw: _Seen, given: Camera, expected: Expected
) -> Tracked:
    """Drops, camera and ends in turn: each makes the others surer."""
    frame_s = float(np.median(np.diff(seen.t_s)))
    gravity = expected.gravity_px(raw.length)
    camera = given
    # an exposure begins later in each row of the picture
    later = given.rolling_s * film.shown(raw.column, raw.row, seen.shape)[1]
    raw = replace(raw, t_s=raw.t_s + later)
    # of a bristle `_lengths` alone leaves out frames in which a hand hides an end
    length = np.full(len(raw.t_s), np.nan) if raw.sights else raw.length
    track = Track(raw.t_s, -raw.row, raw.sigma, given.exposure_s)
    # first sights stray by more than their errors where a film is much compressed
    drops = drops_of(track, gravity) or drops_of(_loosely(track), gravity)
    if raw.sights:
        ends = Ends.of([each.tip for each in raw.sights], 1)
        for turn in range(3):
            if not drops:
                break
            # until an exposure is known, it may be as long as from a frame to the next
            longest = camera.exposure_s if turn or given.exposure_known else frame_s
            speed, bend, free = _motion(replace(track, exposure_s=longest), drops)
            ends = replace(ends, speed=-speed, bend=-bend)
            if turn < 2:
                camera = camera_of(ends, free, frame_s, given)
            fitted = edges(ends, camera)
            sigma = np.maximum(fitted.sigma, LEAST_SIGMA_PX)
            sigma = np.hypot(sigma, _by_gamma(ends, camera, fitted.at))
            track = Track(raw.t_s, -fitted.at, sigma, camera.exposure_s)
            drops = _again(track, gravity)
            track = _scattered(track, drops)
        if drops:
            track = _through_impacts(ends, track, drops, camera)
            drops = settled(drops, _loosely(track))
            track = _through_impacts(ends, track, drops, camera)
            rows = film.shown(np.zeros(2), np.arange(2.0), seen.shape)[1]
            length = _lengths(raw.sights, track, drops, camera, given.rolling_s * np.diff(rows)[0])
    elif drops:
        camera = replace(given, exposure_s=_exposure_of(raw, track, drops, given, frame_s))
        track = replace(track, exposure_s=camera.exposure_s)
        drops = _again(track, gravity)
        track = _scattered(track, drops)
    row = -track.height
    column = raw.column + raw.slope * (row - raw.row)
    vertical = _vertical(track, column, drops)
    down = (row + vertical[0] * column) / np.hypot(1.0, vertical[0])
    track = replace(track, t_s=raw.t_s + 0.5 * camera.exposure_s, height=-down)
    # where an impact lies in the exposure, the height is a mean, which is of no flight
    once = np.setdiff1d(np.arange(len(down)), track.through)
    loose = Track(track.t_s[once], -down[once], _loosely(track).sigma[once])
    drops = [
        replace(drop, first=int(once[drop.first]), last=int(once[drop.last]))
        for drop in drops_of(loose, gravity)
    ]
    found = Tracked(
        film=film,
        body=body,
        shape=seen.shape,
        frame_s=frame_s,
        frames=len(seen.t_s),
        camera=camera,
        number=raw.number,
        t_s=track.t_s,
        column=column,
        row=row,
        down=down,
        sigma=track.sigma,
        turn=np.arctan(vertical[0]) - np.arctan(raw.slope) if raw.sights else None,
        sigma_turn=np.array([each.sigma_slope for each in raw.sights]) if raw.sights else None,
        length=length,
        length_error=raw.length_error,
        width=float(np.median([each.width for each in raw.sights])) if raw.sights else 0.0,
        vertical=vertical,
        drops=settled(drops, track, TURNED if raw.sights else BALL_TURNED),
        damage=seen.damage,
        through=track.through,
    )
    # one whose every frame an impact blurs tells nothing
    return replace(found, drops=[drop for drop in found.drops if len(found.used(drop))])


def _through_impacts(ends: Ends, track: Track, drops: Sequence[Drop], camera: Camera) -> Track:
    """The track in which heights of frames whose exposure has an impact in it are means over the
    exposure: the end comes down to the surface and goes up again, and is drawn so."""
    height, sigma = track.height.copy(), track.sigma.copy()
    through = [np.zeros(0, dtype=int)]
    u = instants(camera.exposure_s)
    for drop in drops:
        own = drop.frames
        t = track.t_s[own]
        own = own[np.abs(t[:, None] - drop.impact_s).min(axis=1, initial=np.inf) < u[-1]]
        speed = np.abs(drop.speed(track.t_s[own] + u[-1]))
        own = own[speed * camera.exposure_s > LEAST_STREAK_PX]
        if not len(own):
            continue
        path = -drop.height(track.t_s[own, None] + u)
        middle = path.mean(axis=1)
        part = replace(ends.of_frames(own), guess=middle)
        found = edges_of(part, path - middle[:, None], camera)
        good = np.abs(found.at - middle) < MOST_OFF_PX
        through.append(own[good])
        height[through[-1]] = -found.at[good]
        sigma[through[-1]] = np.hypot(found.sigma[good], STREAK_SIGMA_PX)
    return replace(track, height=height, sigma=sigma, through=np.concatenate(through))


def _loosely(track: Track) -> Track:
    """The track with errors that allow for what the ends' own leave out."""
    return replace(track, sigma=np.hypot(track.sigma, CHAIN_PX))


def _again(track: Track, gravity: float | None) -> list[Drop]:
    loose = _loosely(track)
    return settled(drops_of(loose, gravity), loose)


def _motion(track: Track, drops: Sequence[Drop]) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Upward speeds and accelerations (frames,) in px and s, and which frames fly freely all
    through an exposure."""
    t = track.t_s
    speed, bend = np.gradient(track.height, t), np.zeros(len(t))
    free: NDArray[np.bool_] = np.zeros(len(t), dtype=bool)
    for drop in drops:
        own = drop.frames
        speed[own] = drop.speed(t[own])
        bend[own] = np.where(drop.phase(t[own]) >= 0, -drop.gravity, 0.0)
        clear = track.clear(drop)
        free[clear] = drop.phase(t[clear] - 0.5 * track.exposure_s) >= 0
    return speed, bend, free


def _by_gamma(ends: Ends, camera: Camera, at: Array) -> Array:
    """By how much fast ends would lie elsewhere if the camera's gamma, which the film does not
    show, were a phone's: a standard error (frames,) in px."""
    unsure: Array = np.zeros(len(at))
    felt = np.abs(ends.speed) * camera.exposure_s > GAMMA_FELT_PX
    if camera.gamma_known or not felt.any():
        return unsure
    other = edges(ends.of_frames(felt), replace(camera, gamma=PHONE_GAMMA))
    unsure[felt] = 0.5 * np.abs(other.at - at[felt])
    return unsure


def _flights(
    track: Track, drops: Sequence[Drop], fewest: int
) -> Iterator[tuple[Drop, NDArray[np.int64]]]:
    """Of each flight of so many frames or more its drop, and the frames that no impact blurs."""
    for drop in drops:
        clear = track.clear(drop)
        phase = drop.phase(track.t_s[clear])
        for own in (clear[phase == k] for k in range(len(drop.flights))):
            if len(own) >= fewest:
                yield drop, own


def _scattered(track: Track, drops: Sequence[Drop]) -> Track:
    """The track with what frames scatter about their parabolas beyond their standard errors:
    compression and textures move ends by more than noise does."""
    squares, own = [], []
    for drop, part in _flights(track, drops, 4):
        left = track.height[part] - drop.height(track.t_s[part])
        # a parabola takes up two or three numbers of a flight's frames
        squares.append(left**2 * len(part) / (len(part) - 2.5))
        own.append(track.sigma[part] ** 2)
    if not squares:
        return replace(track, sigma=np.hypot(track.sigma, FIRST_SIGMA_PX / 2.0))
    # the median of a chi square of one degree is 0.455
    extra = float(np.median(np.concatenate(squares)) / 0.455 - np.median(np.concatenate(own)))
    return replace(track, sigma=np.sqrt(track.sigma**2 + max(extra, 0.0)))


def _lengths(
    sights: Sequence[Sight],
    track: Track,
    drops: Sequence[Drop],
    camera: Camera,
    rolling_s: float,
) -> Array:
    """Lengths (frames,) of the strip in px where both ends are in view and it flies freely, so that
    no hand hides the upper one. A row is exposed ``rolling_s`` later than the one above."""
    speed, bend, free = _motion(track, drops)
    length = np.full(len(sights), np.nan)
    both = np.flatnonzero(free & np.array([each.top is not None for each in sights]))
    if not len(both):
        return length
    tops = Ends.of([end for i in both if (end := sights[i].top) is not None], -1)
    found = edges(replace(tops, speed=speed[both], bend=bend[both]), camera)
    slope = np.array([sights[i].slope for i in both])
    length[both] = (found.at - track.height[both]) * np.hypot(1.0, slope)
    # the lower end is seen later by ``rolling_s`` a row, and has gone on
    return length * (1.0 + speed * rolling_s)


def _exposure_of(
    raw: _Seen, track: Track, drops: Sequence[Drop], given: Camera, frame_s: float
) -> float:
    """The exposure in s by which a ball is drawn long, unless it is given."""
    if given.exposure_known or raw.blur is None:
        return given.exposure_s
    speed, _, free = _motion(replace(track, exposure_s=frame_s), drops)
    if free.sum() < 3:
        return 0.0
    speed, blur = np.abs(speed[free]), raw.blur[free]
    slow, fast = speed < np.percentile(speed, 30), speed > np.percentile(speed, 70)
    faster = float(np.median(speed[fast]) - np.median(speed[slow]))
    drawn = (np.median(blur[fast]) - np.median(blur[slow])) / max(faster, 1e-9)
    return float(np.clip(drawn, 0.0, frame_s))


def _vertical(track: Track, column: Array, drops: Sequence[Drop]) -> tuple[float, float]:
    """The vertical's slope in columns a row, and its standard error: the way that gravity pulls.

    What flies may go to the side evenly as well, which tells nothing of the vertical. Zero where
    flights do not show it better than a level camera would.
    """
    across: list[Array] = []
    along: list[Array] = []
    for _, own in _flights(replace(track, exposure_s=0.0), drops, 3):
        t = track.t_s[own] - track.t_s[own].mean()
        even = np.linalg.qr(np.stack([np.ones_like(t), t], axis=1))[0]
        x, y = (z - even @ (even.T @ z) for z in (column[own], -track.height[own]))
        across, along = [*across, x], [*along, y]
    numbers = 2 * len(across) + 1
    if sum(map(len, across)) < numbers + LEAST_FREEDOM:
        return 0.0, LEVEL
    x, y = np.concatenate(across), np.concatenate(along)
    slope = float(x @ y) / float(y @ y)
    left = x - slope * y
    # a camera that shakes moves neighbours alike
    flight = np.repeat(np.arange(len(across)), [len(each) for each in across])
    square, alike = spread_of(left, flight, numbers)
    error = float(np.sqrt(max(square, LEAST_SIGMA_PX**2) * alike / (y @ y)))
    return (slope, error) if error < LEVEL else (0.0, LEVEL)
