"""The commands of `bristle`.

Only what is light is imported here; a command imports what it needs when it runs.
"""

from __future__ import annotations

import inspect
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from ..solver.errors import ComputationError
from . import __version__
from .command.ending import run
from .command.options import Config, Debug, RanksPerCase, Resume, out_option, takes
from .inputs.fields import (
    DROP_FLAGS,
    LIST_FLAGS,
    OUTPUT,
    PLUGIN,
    STUDY_FLAGS,
    SWEEP_FLAGS,
    BodyFields,
    DiscretisationFields,
    MeshFields,
    StepField,
)
from .inputs.flags import flags_of
from .inputs.loop_fields import LOOP_FLAGS
from .inputs.scatter_fields import SCATTER_FLAGS

REPRODUCE_FLAGS = flags_of(StepField, DiscretisationFields)
MESH_FLAGS = flags_of(BodyFields, MeshFields)
# Keys of a configuration file that a command with other flags passes over.
ANY_FLAGS = (*DROP_FLAGS, *LIST_FLAGS)

# Paragraphs, since typer joins lines.
FIRST_STEPS = "\n\n".join(
    (
        "Each command ends with the file to look at, has `--help` with an example, and writes "
        "into results/ where you are, or into `--out`. **Start with:**",
        "1. `bristle drop`: one drop, in seconds; the result goes into results/drop",
        "1. `bristle view results/drop`: its pictures; after `bristle drop --model solid` "
        "also the wave, as a film and in ParaView",
        "1. `bristle reproduce`: the paper's figures beside ours, about seven minutes; open "
        "results/reproduce/report.html in any browser",
        "1. `bristle close-loop FOLDER`: what the model lacks to explain your own measurements; "
        "README.md says how to write them down",
    )
)
app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=FIRST_STEPS,
)


@app.callback(invoke_without_command=True)
def root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    debug: Debug = False,
) -> None:
    """Impact of a steel bristle on a rigid plane: a 3-D solid, its reduced model, and a beam."""
    if version:
        print(f"bristle {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        print(context.get_help())
        raise typer.Exit


@app.command()
@takes(REPRODUCE_FLAGS)
def reproduce(
    given: dict[str, Any],
    config: Config = None,
    out: Annotated[Path, out_option("results/reproduce")] = Path("results/reproduce"),
    ranks_per_case: RanksPerCase = None,
    debug: Debug = False,
) -> None:
    """Every figure and table of the paper, 1-D and 3-D side by side, on one page: report.html.

    Example: mpirun -n 2 bristle reproduce --out results/reproduce
    """
    from .inputs.config import DropInputs
    from .inputs.sources import inputs_of
    from .reproduce.campaign import Setup
    from .reproduce.run import run_reproduce

    base = inputs_of(DropInputs, given, REPRODUCE_FLAGS, config, ANY_FLAGS)
    done = run_reproduce(out, Setup(base), ranks_per_case=ranks_per_case)
    print(f"{done.n_cases} drops in {done.wall_s:.0f} s: {done.report}")


@app.command()
@takes(DROP_FLAGS)
def drop(
    given: dict[str, Any],
    config: Config = None,
    out: Annotated[Path, out_option("results/drop")] = Path("results/drop"),
    resume: Resume = False,
    keep: Annotated[
        float,
        typer.Option(
            "--keep",
            metavar="SECONDS",
            min=0.0,
            help="How often a march in steps is kept, for --resume to go on from.",
            rich_help_panel=OUTPUT,
        ),
    ] = 60.0,
    debug: Debug = False,
) -> None:
    """One drop. All values are in SI units, angles in degrees.

    A leaning bristle slides, bends and turns: --tilt, --slope and --friction say how. One of any
    shape comes as a mesh: --mesh notched.msh

    Example: bristle drop --model solid --kn 2e6 --height 0.05 --tilt 2 --out results/leaning
    """
    from .drop import run_drop, summary
    from .inputs.config import DropInputs
    from .inputs.sources import inputs_of

    inputs = inputs_of(DropInputs, given, DROP_FLAGS, config)
    document = run_drop(inputs, out, resume=resume, keep_s=keep)
    for name, value in summary(document):
        print(f"{name:<24}{value}")
    print(f"{'result':<24}{out / 'result.json'}")
    print(f"{'pictures of it':<24}{shlex.join(['bristle', 'view', str(out)])}")


@app.command()
@takes(SWEEP_FLAGS)
def sweep(
    given: dict[str, Any],
    config: Config = None,
    out: Annotated[Path, out_option("results/sweep")] = Path("results/sweep"),
    resume: Resume = False,
    ranks_per_case: RanksPerCase = None,
    debug: Debug = False,
) -> None:
    """Normal contact stiffness times height (Fig. 13): a table, and the tip's height over time.

    Without lists: the paper's eleven Kn and five heights, with the beam and the reduced solid, at
    an ITS of 0.01 ms. Any other number or choice may be several too: --tilt 0,2,5

    Example: mpirun -n 2 bristle sweep --models beam,reduced --kn 1e5,2e6,1e8 --heights 0.01,0.05
    """
    from .inputs.sources import inputs_of
    from .sweep import SweepInputs, answer, run_sweep

    inputs = inputs_of(SweepInputs, given, SWEEP_FLAGS, config)
    run_sweep(inputs, out, resume=resume, ranks_per_case=ranks_per_case)
    print(*answer(out), sep="\n")


@app.command()
@takes(STUDY_FLAGS)
def its(
    given: dict[str, Any],
    config: Config = None,
    out: Annotated[Path, out_option("results/its")] = Path("results/its"),
    resume: Resume = False,
    ranks_per_case: RanksPerCase = None,
    debug: Debug = False,
) -> None:
    """The integration time step: what each quantity needs, against stiffness.

    Without lists: seven steps from 1e-7 to 1e-4 s, the paper's eleven Kn, 50 mm, with the beam and
    the reduced solid.

    Example: bristle its --models beam --kn 1e5,2e6,1e8 --its 1e-4,1e-5,1e-6,1e-7
    """
    from .inputs.sources import inputs_of
    from .its.run import ItsInputs, answer, run_its

    inputs = inputs_of(ItsInputs, given, STUDY_FLAGS, config)
    run_its(inputs, out, resume=resume, ranks_per_case=ranks_per_case)
    print(*answer(out), sep="\n")


@app.command()
@takes(SCATTER_FLAGS)
def scatter(
    given: dict[str, Any],
    config: Config = None,
    out: Annotated[Path, out_option("results/scatter")] = Path("results/scatter"),
    resume: Resume = False,
    debug: Debug = False,
) -> None:
    """Thousands of drops that lean by chance onto a rough, composite surface: how y1/y0 scatters.

    Without options: the reduced solid, 2000 drops from the paper's five heights.

    Example: mpirun -n 2 bristle scatter --drops 2000 --tilt-std 2 --beta 1e-8
    """
    from .inputs.sources import inputs_of
    from .scatter.inputs import ScatterInputs
    from .scatter.run import run_scatter

    inputs = inputs_of(ScatterInputs, given, SCATTER_FLAGS, config, ANY_FLAGS)
    run_scatter(inputs, out, resume=resume)


@app.command()
@takes(MESH_FLAGS)
def mesh(
    given: dict[str, Any],
    config: Config = None,
    out: Annotated[Path, out_option("results/mesh")] = Path("results/mesh"),
    debug: Debug = False,
) -> None:
    """The hexahedral bristle: .msh, a copy that ParaView opens, a quality table, a picture.

    Example: bristle mesh --diameter 1e-3 --cells 2 1 200 --grading 4
    """
    from ..meshes.check import MeshError
    from ..meshes.display import DrawingError
    from .inputs.config import MeshInputs
    from .inputs.sources import inputs_of
    from .mesh import run_mesh
    from .running.files import prepare_folder_together

    inputs = inputs_of(MeshInputs, given, MESH_FLAGS, config, ANY_FLAGS)
    prepare_folder_together(out)
    try:
        summary = run_mesh(inputs.mesh_spec(), out)
    except (MeshError, DrawingError) as error:
        raise ComputationError(str(error)) from error
    print(f"{summary['quality']['n_cells']} cells, {summary['quality']['n_nodes']} nodes")
    for path in sorted(
        map(Path, summary["files"].values()), key=lambda path: path.suffix == ".png"
    ):
        print(path)


@app.command()
def calibrate(
    dataset: Annotated[
        str,
        typer.Argument(
            metavar="DATASET", help="Folder of a dataset, or 'paper'.", show_default=False
        ),
    ],
    out: Annotated[Path, out_option("results/calibrate")] = Path("results/calibrate"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the bootstrap.")] = 0,
    level: Annotated[float, typer.Option(min=0.5, max=0.999, help="Level of the intervals.")] = 0.9,
    debug: Debug = False,
) -> None:
    """Normal contact stiffness, with its interval, from measured drops.

    Example: bristle calibrate paper --out results/calibrate
    """
    from .calibrate.run import run_calibrate, told

    for name, value in told(run_calibrate(dataset, out, seed=seed, level=level)):
        print(f"{name:<24}{value}")
    print(f"{'page':<24}{out / 'report.html'}")


@app.command()
def synth(
    effect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME:PARAM=VALUE,…",
            help="An effect that the dataset hides; repeatable.",
            show_default=False,
        ),
    ] = None,
    plugin: Annotated[
        list[str] | None,
        typer.Option(
            metavar=PLUGIN.metavar,
            help=PLUGIN.help,
            show_default=False,
        ),
    ] = None,
    unlisted: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=STRENGTH",
            help="An effect that no list has: session-shift, height-ripple or alternation, with "
            "its relative strength on the height after.",
            show_default=False,
        ),
    ] = None,
    drops: Annotated[int, typer.Option(min=6, max=10_000, help="How many drops.")] = 48,
    kn: Annotated[float, typer.Option(min=2e5, max=5e7, help="Contact stiffness, N/m.")] = 2e6,
    noise: Annotated[
        str,
        typer.Option(help="Its kind: gaussian, heavy-tailed, outliers or autocorrelated."),
    ] = "gaussian",
    sigma_y: Annotated[
        float, typer.Option(min=1e-6, max=1e-2, help="Standard error of a height, m.")
    ] = 3e-4,
    heights_only: Annotated[
        bool, typer.Option("--heights-only", help="Without contact times and forces.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of release, chance and errors.")] = 0,
    out: Annotated[Path, out_option("results/synth")] = Path("results/synth"),
    truth: Annotated[
        Path, typer.Option(metavar="FILE", help="Where the truth goes, outside the dataset.")
    ] = Path("results/synth-truth.json"),
    debug: Debug = False,
) -> None:
    """A dataset of drops with an effect in it that it does not declare, by the reduced solid.

    Example: bristle synth --effect contact_damping:c_N_s_m=5 --out results/mystery
    """
    from .synth import recipe_of, run_synth

    recipe = recipe_of(
        effect or [],
        unlisted,
        plugin or [],
        n_drops=drops,
        kn_N_m=kn,
        noise=noise,
        sigma_y_m=sigma_y,
        sensors=not heights_only,
        seed=seed,
    )
    run_synth(recipe, out, truth)
    print(f"{'dataset':<24}{out / 'dataset.toml'}")
    print(f"{'what is in it':<24}{truth}")
    print(f"{'to look for it':<24}{shlex.join(['bristle', 'close-loop', str(out)])}")


@app.command("close-loop")
@takes(LOOP_FLAGS)
def close_loop(
    given: dict[str, Any],
    dataset: Annotated[
        Path, typer.Argument(metavar="DATASET", help="Folder of a dataset.", show_default=False)
    ],
    config: Config = None,
    out: Annotated[Path, out_option("results/close-loop")] = Path("results/close-loop"),
    debug: Debug = False,
) -> None:
    """What the model lacks to explain measured data, and the error before and after it is added.

    Fits the model to the dataset (kinds: drops, tracks, forces, waves, falls), tests what is left,
    traces it to an effect or says that no known one explains it, and judges on held-out data.

    Example: bristle close-loop my-drops --seed 1 --out results/my-drops
    """
    from .close_loop.run import run_close_loop, summary
    from .inputs.loop_fields import LoopInputs
    from .inputs.sources import inputs_of

    inputs = inputs_of(LoopInputs, given, LOOP_FLAGS, config, ANY_FLAGS)
    for name, value in summary(run_close_loop(dataset, out, inputs)):
        print(f"{name:<24}{value}")
    print(f"{'page':<24}{out / 'report.html'}")


@app.command()
def bench(
    what: Annotated[
        str,
        typer.Argument(
            metavar="[peers|step|sizes|ranks]",
            help="peers: time, memory and error beside other programs of the same impact. "
            "step: what a step of the solid costs. sizes: time and memory against unknowns. "
            "ranks: what more ranks gain.",
        ),
    ] = "peers",
    repeats: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=100,
            help="peers, step, ranks: how often each is timed. [default: 3; step: 15]",
            show_default=False,
        ),
    ] = None,
    largest: Annotated[
        int | None,
        typer.Option(
            min=1, help="sizes: the most unknowns. [default: 3000000]", show_default=False
        ),
    ] = None,
    most: Annotated[
        int | None,
        typer.Option(min=1, help="ranks: the most ranks. [default: the cores]", show_default=False),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for the result. [default: results/bench-WHAT]",
            show_default=False,
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """How fast is it, and how near? A table, and a page with the figures behind it.

    Without a name: this program beside a naive dolfinx loop, plain scipy, and CalculiX where it is
    installed, at equal error; six minutes, on a machine that should do nothing else.

    Example: bristle bench --repeats 5
    """
    from .bench import run_bench

    given = {"repeats": repeats, "largest": largest, "most": most}
    print(run_bench(what, out, given))


@app.command()
def view(
    result: Annotated[
        Path,
        typer.Argument(metavar="RESULT", help="Folder of a drop's result.", show_default=False),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for the pictures. [default: RESULT/view]",
            show_default=False,
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """Pictures of a drop's result; of a solid's also the wave as a film, and a script for ParaView.

    Example: bristle view results/drop
    """
    from .view.run import run_view

    for path in run_view(result, out):
        print(path)


# Paragraphs stay apart only behind a \b: typer joins the others.
for each in app.registered_commands:
    each.help = (inspect.getdoc(each.callback) or "").replace("\n\n", "\n\n\b\n")


def main(args: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status, see `ending.run`."""
    return run(typer.main.get_command(app), list(sys.argv[1:] if args is None else args))


if __name__ == "__main__":
    sys.exit(main())
