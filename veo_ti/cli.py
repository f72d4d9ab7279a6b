"""The `veo` command. Heavy packages load inside the commands, so that help is instant."""

import json
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter

from veo_ti import cli_beam, cli_capture, cli_footage, cli_reconstruct
from veo_ti.cli_beam import EVERY, MODES
from veo_ti.diagnosis.effort import STEPS

app = App(
    name="veo",
    help="Virtual elastic objects: tracked points and known forces in, per-point material out.",
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)


@app.command
def run(
    source: Annotated[str, Parameter(name="INPUT")],
    *,
    out: Path,
    modes: int = MODES,
    every: int = EVERY,
    paper: bool = False,
    diagnose: bool = True,
    device: cli_reconstruct.Device = "cpu",
) -> dict[str, object]:
    """Do everything that applies to INPUT, into one folder.

    Parameters
    ----------
    source
        an .npz or .vtkhdf measurement, a PLUSH object folder, a recording with mattes that is not reconstructed yet, a
        folder of beam takes, or the word example.
    out
        folder for the results; an interrupted run goes on when called again.
    modes
        how finely the stiffness may vary.
    every
        hold out one frame in so many.
    paper
        use the paper's plain discretisation instead of the consistent one.
    diagnose
        also look for what the simulation gets wrong, and why (a minute more, three where something is wrong).
    device
        what trains, renders and simulates: cpu, or cuda where torch has it.
    """
    cli_reconstruct.use(device)
    folder = Path(source)
    if cli_reconstruct.is_recording(folder):
        return cli_reconstruct.run_recording(folder, out, modes, every)
    if cli_beam.is_beam(folder):
        return cli_beam.run(folder, out, diagnosed=diagnose, modes=modes, every=every, paper=paper)
    return _identify(source, out, modes, every, paper, diagnose)


@app.command
def identify(
    source: Annotated[str, Parameter(name="INPUT")],
    *,
    out: Path,
    modes: int = MODES,
    every: int = EVERY,
    paper: bool = False,
) -> dict[str, object]:
    """Learn per-point Lame parameters from INPUT and judge them on held-out frames.

    Parameters are those of `veo run`.
    """
    return _identify(source, out, modes, every, paper)


@app.command
def diagnose(
    source: Annotated[str, Parameter(name="INPUT")],
    *,
    out: Path,
    modes: int = MODES,
    every: int = EVERY,
    second: bool = True,
    effort: float = STEPS,
) -> dict[str, object]:
    """Say what a simulation of INPUT gets wrong, which physical cause explains it, and what knowing it gains.

    Other parameters are those of `veo run`. A folder of beam takes has no use for any, and one look.

    Parameters
    ----------
    effort
        Newton's steps of all frames, after which it ends with what it knows; counted, not timed, so that the same data
        give the same answer on any machine.
    second
        Look for a second cause, and for two at once where none alone explains what is wrong. That may take several
        times as long; what the first look said is in diagnosis.json meanwhile.
    """
    folder = Path(source)
    if cli_beam.is_beam(folder):
        return cli_beam.diagnose(folder, out, modes=modes, every=every, effort=effort)
    from veo_ti.commands import diagnose_source

    return diagnose_source(source, out, modes=modes, every=every, second=second, effort=effort)


@app.command
def causes() -> None:
    """List every cause that `veo diagnose` knows, with its parameters and their units."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from veo_ti.diagnosis.causes import CATALOGUE

    table = Table(box=box.SIMPLE)
    table.add_column("cause", no_wrap=True)
    table.add_column("parameters", no_wrap=True)
    table.add_column("what is wrong")
    for cause in CATALOGUE:
        table.add_row(cause.name, "\n".join(f"{p.name} [{p.unit}]" for p in cause.parameters), cause.sentence)
    Console(markup=False).print(table)


@app.command
def coupon(
    source: Annotated[str, Parameter(name="INPUT")], *, out: Path, fit: str | None = None, up_to: float | None = None
) -> dict[str, object]:
    """Say what the Neo-Hookean law gets wrong on stress-stretch curves, why, and what knowing it gains elsewhere.

    Parameters
    ----------
    source
        an .npz or .csv of curves, an .npz of a strip's tracked points, or the word treloar.
    out
        folder for coupon.json, pictures and report.html.
    fit
        modes to fit, such as UT,PS; the others are predicted and judged.
    up_to
        fit stretches up to this one only; the others are predicted and judged.
    """
    from veo_ti.coupons.command import coupon_source

    return coupon_source(source, out, fit=fit, up_to=up_to)


@app.command
def evaluate(obj: Annotated[Path, Parameter(name="OBJECT")], source: Annotated[str, Parameter(name="INPUT")], *,
             out: Path) -> dict[str, object]:  # fmt: skip
    """Simulate an identified OBJECT under the loads of INPUT and measure the distance."""
    from veo_ti.commands import evaluate_object

    return evaluate_object(obj, source, out)


@app.command
def simulate(
    obj: Annotated[Path, Parameter(name="OBJECT")],
    *,
    out: Path,
    force: list[str] | None = None,
    gravity: str | None = None,
    contact: list[str] | None = None,
    steps: int = 12,
) -> dict[str, object]:
    """Push an identified OBJECT, change its gravity, or press things on it; forces grow over the steps.

    Parameters
    ----------
    obj
        a folder of `veo identify`, or a .vtkhdf.
    out
        folder for the results.
    force
        "fx,fy,fz@x,y,z,radius" in N and m: a force spread over the surface around a place.
    gravity
        "gx,gy,gz" in m/s2, instead of the rest pose's.
    contact
        "plane:x,y,z,nx,ny,nz", "sphere:x,y,z,r", "capsule:x,y,z,ax,ay,az,r", "box:x,y,z,hx,hy,hz" or "mesh:FILE";
        add "@dx,dy,dz" to have it move that far over the steps.
    steps
        frames over which the loads grow to their full size.
    """
    from veo_ti.commands import simulate_object

    return simulate_object(obj, out, force or [], gravity, contact or [], steps)


@app.command
def doctor() -> int:
    """Say what works on this machine, and what to do about what does not."""
    from rich.console import Console
    from rich.table import Table

    from veo_ti.doctor import examine

    console, table = Console(), Table("", "part", "version", "what to do")
    console.print("What veo_ti needs, and whether this machine has it:")
    findings = examine()
    for finding in findings:
        mark = "ok" if finding.ok else "MISSING" if finding.needed else "-"
        table.add_row(mark, finding.name, finding.version, finding.sentence)
    console.print(table)
    return int(any(not f.ok and f.needed for f in findings))


for command in (
    *(cli_capture.capture, cli_capture.inspect, cli_capture.rig),
    *(cli_footage.calibrate, cli_footage.track, cli_footage.matte),
    *(cli_reconstruct.reconstruct, cli_reconstruct.render),
):
    app.command(command)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and print what it found as JSON.

    Exit status 0; 1: not everything works; 2: wrong input, in one sentence; 130: Ctrl-C.
    """
    try:
        result = app(arguments, exit_on_error=False, print_error=True)
        if isinstance(result, dict):
            print(json.dumps(result, indent=2))
        return result if isinstance(result, int) else 0
    except CycloptsError:
        return 2
    except (ValueError, OSError) as error:
        print(f"veo: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("veo: interrupted; what was done so far is kept, the same command goes on from there", file=sys.stderr)
        return 130


def _identify(
    source: str, out: Path, modes: int, every: int, paper: bool, diagnosed: bool = False
) -> dict[str, object]:
    from veo_ti.commands import identify_source

    return identify_source(source, out, modes=modes, every=every, paper=paper, diagnosed=diagnosed)
