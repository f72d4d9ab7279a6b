"""`veo run` and `veo diagnose` of a folder of beam takes; heavy packages load inside."""

from pathlib import Path

from sim.checks import require
from veo_ti.diagnosis.effort import STEPS

MODES, EVERY = 80, 4  # unless told otherwise


def is_beam(folder: Path) -> bool:
    """Whether the folder holds takes."""
    return folder.is_dir() and any(folder.glob("beam_*.npz"))


def run(folder: Path, out: Path, *, diagnosed: bool, modes: int, every: int, paper: bool) -> dict[str, object]:
    """Identify the beam from settled poses, and say what its motion after release tells.

    Raises ValueError where an option is given that these have no use for.
    """
    from veo_ti.beam_report import run_beam

    _none_given(modes=(modes, MODES), every=(every, EVERY), paper=(paper, False))
    metrics = run_beam(folder, out)
    return {**metrics, "diagnosis": diagnose(folder, out / "release")} if diagnosed else metrics


def diagnose(
    folder: Path, out: Path, *, modes: int = MODES, every: int = EVERY, effort: float = STEPS
) -> dict[str, object]:  # fmt: skip
    """What the motion after release says. Raises ValueError where an option is given that it has no use for."""
    from veo_ti.beam_dynamics.report import run_beam_diagnosis
    from veo_ti.progress import console, waiting

    _none_given(modes=(modes, MODES), every=(every, EVERY), effort=(effort, STEPS))
    with waiting("diagnosis") as say:
        found = run_beam_diagnosis(folder, out, progress=say)
    console.print(found["sentence"])
    return found


def _none_given(**options: tuple[object, object]) -> None:
    """Each as it was given, and as it is unless told otherwise."""
    for name, (value, usual) in options.items():
        require(value == usual, f"--{name}", "be left out for a folder of beam takes, which has no use for it", value)
