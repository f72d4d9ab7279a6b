"""What `veo calibrate` does: find the board, calibrate lenses and rig, say how well all of it is known."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from recon.calibration.bundle import BundleOptions
from recon.calibration.calibrate import CameraReport, RigReport, calibrate_rig
from recon.calibration.charuco import Board, BoardViews
from recon.cameras import Camera
from recon.plush.calibration import COEFFICIENTS, camera_of, read_calibration, write_calibration
from sim.checks import require
from veo_ti.footage.boards import USED, board_views, spelled_board, tiles
from veo_ti.footage.sources import RESULT, footage_of
from veo_ti.inspect_pictures import contact_sheet, rig_picture
from veo_ti.report import Section, Table, write_report
from veo_ti.store import writable_folder, write_json_atomic

FEW = 15  # moments, below which the sentence says so
WRONG = 0.005  # of the picture's longer side: corners farther off mean another board than the one described


def board_of(squares: str, square_mm: float, marker_mm: float, dictionary: str, legacy: bool) -> Board:
    """The printed board; squares: columns x rows, such as 9x6. Raises ValueError for what is no board."""
    columns, _, rows = squares.lower().partition("x")
    require(columns.isdigit() and rows.isdigit(), "--squares", "be columns x rows, like 9x6", repr(squares))
    return Board(
        columns=int(columns), rows=int(rows), square=square_mm / 1e3, marker=marker_mm / 1e3, dictionary=dictionary,
        legacy=legacy,
    )  # fmt: skip


def calibrate_folder(
    folder: str | Path,
    out: str | Path,
    board: Board,
    *,
    lenses: str | Path | None = None,
    coefficients: int = 5,
    without: Sequence[str] = (),
    say: Callable[[str], None] | None = None,
) -> dict[str, object]:
    """Calibrate the cameras of a folder; write calibration.json (PLUSH), calibrate.json, pictures and calibrate.html.

    lenses: a calibration.json whose lenses are kept; coefficients: distortion numbers of lenses that are not given.
    The first camera by name stands at the world's origin, as in PLUSH. What was found is kept in out/views, so that
    an interrupted call goes on from there. Raises ValueError naming file and camera for a camera that never sees the
    board or shares no moment with the others, a board that is not the one described, and pictures of another size.
    """
    say = say or (lambda text: None)
    fits = coefficients in (0, 4, 5, 8, COEFFICIENTS)
    require(fits, "--coefficients", f"be 0, 4, 5, 8 or {COEFFICIENTS}, as the PLUSH layout holds", coefficients)
    footage, out = footage_of(folder, without), writable_folder(out)
    known = None if lenses is None else _lenses(Path(lenses), {n: s.size for n, s in footage.sources.items()})
    views = board_views(board, footage, out / "views", say)
    say("lenses and places")
    options = BundleOptions(coefficients=coefficients) if known is None else None
    cameras, report = calibrate_rig(board, views, cameras=known, options=options)
    _require_same_board(board, report, cameras)
    write_calibration(out / "calibration.json", cameras)
    facts = _facts(board, footage.moments, report, given=known is not None)
    write_json_atomic(out / RESULT, facts)
    say("pictures")
    sections = _sections(facts, cameras, views, out)
    write_report(out / "calibrate.html", f"Calibration of {Path(folder).resolve().name}", facts["sentence"], sections)
    return facts


def _lenses(path: Path, sizes: dict[str, tuple[int, int]]) -> list[Camera]:
    entries = read_calibration(path)
    lacking = [name for name in sizes if name not in entries]
    require(not lacking, path.name, "hold the lens of every camera", f"none of {', '.join(lacking)}")
    return [camera_of(name, entries[name], size, path.name) for name, size in sizes.items()]


def _require_same_board(board: Board, report: RigReport, cameras: Sequence[Camera]) -> None:
    """Raise ValueError naming the camera whose corners fit no place of such a board."""
    for camera, fitted in zip(cameras, report.cameras, strict=True):
        got = f"corners {fitted.error_px:.3g} pixels from where they should be"
        rule = f"show the board of {spelled_board(board)}"
        require(fitted.error_px <= WRONG * max(camera.size), f"{camera.name} pictures", rule, got)


def _facts(board: Board, moments: int, report: RigReport, given: bool) -> dict[str, object]:
    few = f" (more, up to {USED}, tell more)" if len(report.shots) < FEW else ""
    worst = max(report.cameras, key=lambda camera: camera.error_px)
    place = max(camera.place_error_mm for camera in report.cameras)
    several = f", and places are known to {place:.2g} mm as far as the noise of corners goes" if place else ""
    sentence = (
        f"{len(report.cameras)} cameras calibrated from {len(report.shots)} moments{few}: corners lie "
        f"{report.error_px:.2f} pixels from where they should be, {worst.error_px:.2f} in {worst.name}, the worst"
        f"{several}."
    )
    return {
        "sentence": sentence,
        "board": spelled_board(board),
        "lenses_given": given,
        "moments": moments,
        "moments_used": report.shots.tolist(),
        "error_px": report.error_px,
        "noise_px": report.noise_px,
        "cameras": {camera.name: _camera_facts(camera) for camera in report.cameras},
        "sentences": list(report.sentences),
    }


def _camera_facts(camera: CameraReport) -> dict[str, object]:
    names = ("views", "corners", "strays", "error_px", "covered", "turn_error_deg", "place_error_mm", "focal_error_px")
    values = {name: getattr(camera, name) for name in names}
    sound = {name: value if np.isfinite(value) else None for name, value in values.items()}
    return sound | {"sentences": list(camera.sentences)}


def _sections(
    facts: dict[str, object], cameras: Sequence[Camera], views: Sequence[BoardViews], out: Path
) -> list[Section]:
    """The page's parts; their pictures are written into `out` as they are made."""
    rows = [
        [name, c["views"], c["corners"], c["strays"], c["error_px"], f"{c['covered']:.0%}", c["turn_error_deg"],
         c["place_error_mm"], c["focal_error_px"]]
        for name, c in facts["cameras"].items()
    ]  # fmt: skip
    columns = ["camera", "views", "corners", "left out", "error [px]", "covered", "direction known to [deg]",
               "place known to [mm]", "focal length known to [px]"]  # fmt: skip
    text = (
        "One line a camera: how far corners lie from where the calibration expects them, how much of the picture the "
        "board has covered, and standard errors; the first camera has none, it defines the world."
    )
    notes = [[note] for note in facts["sentences"]]
    sections = [Section(heading="Cameras", text=text, table=Table(columns=columns, rows=rows))]
    if notes:
        table = Table(columns=["what"], rows=notes)
        sections.append(Section(heading="What may be mended", text="More pictures help.", table=table))
    sheet = contact_sheet(tiles(views), out / "coverage.png")
    text = "A dot is a corner of the board: where there are none, the lens is a guess."
    sections.append(Section(heading="Where the board was seen", text=text, pictures=[sheet]))
    if len({camera.device for camera in cameras}) > 1:
        colour = [camera for camera in cameras if camera.stream == "colour"] or list(cameras)
        text = f"The size comes from the board: {facts['board']}; measure the print."
        picture = rig_picture(colour, None, None, out / "rig.png")
        sections.append(Section(heading="The rig", text=text, pictures=[picture]))
    return sections
