"""The commands of `bristle`.

Only what is light is imported here; a command imports what it needs when it runs.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

import click
from typer.core import TyperGroup

from . import __version__
from .command.ending import run
from .command.options import (
    A_PATH,
    DEBUG,
    KEEP,
    RANKS_PER_CASE,
    RESUME,
    Given,
    a_folder,
    add_command,
    argument,
    of_files,
    option,
)
from .inputs.brush_fields import BRUSH_FLAGS
from .inputs.fields import (
    DROP_FLAGS,
    LIST_FLAGS,
    MESH_FLAGS,
    STUDY_FLAGS,
    SWEEP_FLAGS,
    DiscretisationFields,
    StepField,
)
from .inputs.flags import flags_of
from .inputs.study_fields import (
    CALIBRATE_FLAGS,
    LOOP_FLAGS,
    SCATTER_FLAGS,
    SYNTH_FLAGS,
    TRACK_FLAGS,
    CalibrateInputs,
    LoopInputs,
    Recipe,
    TrackInputs,
)

REPRODUCE_FLAGS = flags_of(StepField, DiscretisationFields)
# Keys of a configuration file that a command with other flags passes over.
ANY_FLAGS = (*DROP_FLAGS, *LIST_FLAGS)

# Paragraphs, since typer joins lines.
FIRST_STEPS = "\n\n".join(
    (
        "Each command ends with the file to look at, has `--help` with an example, and writes "
        "into results/ where you are, or into `--out`. **Start with:**",
        "1. `bristle drop`: one drop, in seconds (minutes the first time, for compiling); the "
        "result goes into results/drop",
        "1. `bristle view results/drop`: its pictures; after `bristle drop --model solid` "
        "also the wave, as a film and in ParaView",
        "1. `bristle reproduce`: the paper's figures beside ours, in 7 to 20 minutes; open "
        "results/reproduce/report.html in any browser",
        "1. `bristle close-loop FOLDER`: what the model lacks to explain your own measurements; "
        "docs/measurements.md says how to write them down",
    )
)


@click.pass_context
def root(context: click.Context, version: bool, debug: bool) -> None:
    """Impact of bristles on a hard surface: one that falls, or a brush, and what measurements show
    that the model lacks."""
    if version:
        print(f"bristle {__version__}")
    elif context.invoked_subcommand is None:
        print(context.get_help())
    else:
        return
    context.exit()


VERSION = option("--version", is_flag=True, default=False, help="Print the version.")
app = TyperGroup(
    callback=root,
    invoke_without_command=True,
    params=[VERSION, DEBUG],
    help=root.__doc__,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=FIRST_STEPS,
)
command = partial(add_command, app)


def show(rows: Iterable[tuple[str, object]]) -> None:
    """Print names and values."""
    for name, value in rows:
        print(f"{name:<24}{value}")


@command(RANKS_PER_CASE, flags=REPRODUCE_FLAGS, ignored=ANY_FLAGS)
def reproduce(given: Given, out: Path, ranks_per_case: int | None) -> None:
    """Every figure and table of the paper, 1-D and 3-D side by side, on one page: report.html.

    Example: mpirun -n 2 bristle reproduce --out results/reproduce
    """
    from .inputs.config import DropInputs
    from .reproduce.campaign import Setup
    from .reproduce.run import run_reproduce

    setup = Setup(given.inputs(DropInputs))
    done = run_reproduce(out, setup, ranks_per_case=ranks_per_case)
    print(f"{done.n_cases} drops in {done.wall_s:.0f} s: {done.report}")


@command(RESUME, KEEP, flags=DROP_FLAGS)
def drop(given: Given, out: Path, resume: bool, keep: float) -> None:
    """One drop. All values are in SI units, angles in degrees.

    A bristle that leans slides, bends and turns: see --tilt, --slope and --friction. A bristle of
    any shape comes as a mesh: --mesh notched.msh

    Example: bristle drop --model solid --kn 2e6 --height 0.05 --tilt 2 --out results/leaning
    """
    from .drop import run_drop, summary
    from .inputs.config import DropInputs

    document = run_drop(given.inputs(DropInputs), out, resume=resume, keep_s=keep)
    show(summary(document))
    show([("result", out / "result.json"), ("pictures of it", _next("view", out))])


@command(RESUME, RANKS_PER_CASE, flags=SWEEP_FLAGS)
def sweep(given: Given, out: Path, resume: bool, ranks_per_case: int | None) -> None:
    """Drops for each normal contact stiffness and each height (Fig. 13 of the paper): a table, and
    the tip's height over time.

    Without lists: the paper's eleven Kn and five heights, with the beam and the reduced solid, at
    an ITS of 0.01 ms. Other numbers and choices take lists too: --tilt 0,2,5

    Example: mpirun -n 2 bristle sweep --models beam,reduced --kn 1e5,2e6,1e8 --heights 0.01,0.05
    """
    from .sweep import SweepInputs, answer, run_sweep

    run_sweep(given.inputs(SweepInputs), out, resume=resume, ranks_per_case=ranks_per_case)
    print(*answer(out), sep="\n")


@command(RESUME, RANKS_PER_CASE, flags=STUDY_FLAGS)
def its(given: Given, out: Path, resume: bool, ranks_per_case: int | None) -> None:
    """The longest integration time step that each quantity allows, for each stiffness.

    Without lists: seven steps from 1e-7 to 1e-4 s, the paper's eleven Kn, 50 mm, with the beam and
    the reduced solid. If a drop fails, its row has no values.

    Example: bristle its --models beam --kn 1e5,2e6,1e8 --its 1e-4,1e-5,1e-6,1e-7
    """
    from .its import ItsInputs, answer, run_its

    run_its(given.inputs(ItsInputs), out, resume=resume, ranks_per_case=ranks_per_case)
    print(*answer(out), sep="\n")


@command(RESUME, flags=SCATTER_FLAGS, ignored=ANY_FLAGS)
def scatter(given: Given, out: Path, resume: bool) -> None:
    """Thousands of drops that lean by chance onto rough concrete: how y1/y0 scatters.

    Without options: the reduced solid, 2000 drops from the paper's five heights.

    Example: mpirun -n 2 bristle scatter --drops 2000 --tilt-std 2 --beta 1e-8
    """
    from .scatter.inputs import ScatterInputs
    from .scatter.run import run_scatter

    run_scatter(given.inputs(ScatterInputs), out, resume=resume)


@command(RESUME, KEEP, flags=BRUSH_FLAGS, ignored=ANY_FLAGS)
def brush(given: Given, out: Path, resume: bool, keep: float) -> None:
    """Bristles clamped in a hub that is pressed on a surface and moved: force and torque on it.

    Without options: one bristle, dragged for a second at 1 m/s.

    Example: bristle brush --layout cup --count 240 --rows 2 --flare 20 --motion rotate:rpm=100
    """
    from .brush.inputs import BrushInputs
    from .brush.run import run_brush, summary

    document = run_brush(given.inputs(BrushInputs), out, resume=resume, keep_s=keep)
    show(summary(document))
    show([("page", out / "report.html")])


@command(flags=MESH_FLAGS, ignored=ANY_FLAGS)
def mesh(given: Given, out: Path) -> None:
    """The hexahedral bristle: .msh, a copy that ParaView opens, a quality table, a picture.

    Example: bristle mesh --diameter 1e-3 --cells 2 1 200 --grading 4
    """
    from .inputs.config import MeshInputs
    from .mesh.run import run_mesh

    summary = run_mesh(given.inputs(MeshInputs).mesh_spec(), out)
    print(f"{summary['quality']['n_cells']} cells, {summary['quality']['n_nodes']} nodes")
    for path in sorted(
        map(Path, summary["files"].values()), key=lambda path: path.suffix == ".png"
    ):
        print(path)


@command(
    argument("dataset", "DATASET", "Folder of a dataset, or 'paper'.", type=str),
    flags=CALIBRATE_FLAGS,
)
def calibrate(given: Given, dataset: str, out: Path) -> None:
    """Normal contact stiffness, with its interval, from measured drops.

    Example: bristle calibrate paper --out results/calibrate
    """
    from .calibrate.run import run_calibrate, told

    show(told(run_calibrate(dataset, out, given.inputs(CalibrateInputs))))
    show([("page", out / "report.html")])


@command(
    of_files(
        "--truth",
        type=A_PATH,
        metavar="FILE",
        help="File for the truth. [default: OUT-truth.json]",
    ),
    flags=SYNTH_FLAGS,
    ignored=ANY_FLAGS,
)
def synth(given: Given, out: Path, truth: Path | None) -> None:
    """Makes a dataset of drops with an effect that the dataset does not declare.

    The reduced solid computes the drops.

    Example: bristle synth --effect contact_damping:c_N_s_m=5 --out results/mystery
    """
    from .synth import FILMS, run_synth

    truth, recipe = truth or Path(f"{out}-truth.json"), given.inputs(Recipe)
    run_synth(recipe, out, truth)
    if recipe.film:
        films = shlex.join(["bristle", "track", str(out / FILMS)])
        show([("films", out / FILMS), ("what is in them", truth)])
        show([("to read them", f"{films}/*.mp4")])
        return
    show([("dataset", out / "dataset.toml"), ("what is in it", truth)])
    show([("to look for it", _next("close-loop", out))])


@command(
    argument("dataset", "DATASET", "Folder of a dataset."), flags=LOOP_FLAGS, ignored=ANY_FLAGS
)
def close_loop(given: Given, dataset: Path, out: Path) -> None:
    """What the model lacks to explain measured data, and the error before and after it is added.

    Fits the model to a dataset of drops, tracks, forces, waves or falls, and tests whether it
    explains the data. If not, looks for the effect that the model lacks. Held-out data, which take
    no part in the fit, judge the result.

    Example: bristle close-loop my-drops --seed 1 --out results/my-drops
    """
    from .close_loop.run import run_close_loop, summary

    show(summary(run_close_loop(dataset, out, given.inputs(LoopInputs))))
    show([("page", out / "report.html")])


@command(argument("films", "FILM…", "Films, or folders of pictures.", nargs=-1), flags=TRACK_FLAGS)
def track(given: Given, films: Sequence[Path], out: Path) -> None:
    """Turns films of drops into a dataset: the height of the lower end in each frame, its
    uncertainty, and how the bristle leans.

    A film needs a still camera and a body that falls freely in view. One film may show several
    drops. Open report.html to see whether the marks lie on the body.

    Example: bristle track drop1.mp4 drop2.mp4 --out results/my-films
    """
    from .track.run import run_track, told

    document, _ = run_track(films, out, given.inputs(TrackInputs))
    show(told(document))
    show([("dataset", out / "dataset.toml"), ("page", out / "report.html")])


@command(
    argument(
        "what",
        "[peers|step|sizes|ranks]",
        "peers: time, memory and error beside other programs of the same impact. "
        "step: what a step of the solid costs. sizes: time and memory against unknowns. "
        "ranks: what more ranks gain.",
        type=str,
        default="peers",
    ),
    option(
        "--repeats",
        type=click.IntRange(1, 100),
        help="peers, step, ranks: how often each is timed. [default: 3; step: 15]",
    ),
    option(
        "--largest",
        type=click.IntRange(1),
        help="sizes: the most unknowns. [default: 3000000]",
    ),
    option("--most", type=click.IntRange(1), help="ranks: the most ranks. [default: the cores]"),
    a_folder(help="Folder for the result. [default: results/bench-WHAT]"),
)
def bench(what: str, out: Path | None, **given: int | None) -> None:
    """Time, memory and error of this program beside others: a table, and a page with figures.

    Without a name: this program beside a naive dolfinx loop, plain scipy, and CalculiX where it is
    installed, at equal error. This takes six minutes. The machine should do nothing else.

    Example: bristle bench --repeats 5
    """
    from .bench import run_bench

    print(run_bench(what, out, given))


@command(
    argument("result", "RESULT", "Folder of a drop's or a brush's result."),
    a_folder(help="Folder for the pictures. [default: RESULT/view]"),
)
def view(result: Path, out: Path | None) -> None:
    """Pictures of the result of a drop or a brush. A brush also gives a film. A drop of the solid
    gives a film of the wave and a script for ParaView.

    Example: bristle view results/drop
    """
    from .view.run import run_view

    for path in run_view(result, out):
        print(path)


def _next(name: str, folder: Path) -> str:
    """The command to go on with."""
    return shlex.join(["bristle", name, str(folder)])


def main(args: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status, see `ending.run`."""
    return run(app, list(sys.argv[1:] if args is None else args))


if __name__ == "__main__":
    sys.exit(main())
