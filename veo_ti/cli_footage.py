"""The `veo` commands that turn films into cameras, the nozzle's path and mattes; heavy packages load inside."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from veo_ti.cli_capture import Folder


def calibrate(
    folder: Folder,
    *,
    out: Path,
    squares: str = "9x6",
    square_mm: float = 40.0,
    marker_mm: float = 30.0,
    dictionary: str = "DICT_5X5_1000",
    legacy: Annotated[bool, Parameter(negative="")] = False,
    lenses: Path | None = None,
    coefficients: int = 5,
    without: list[str] | None = None,
) -> dict[str, object]:
    """Calibrate cameras, their lenses and where they stand, from films or pictures of a ChArUco board.

    Parameters
    ----------
    folder
        videos capture/cam0001.aligned.mp4, ... as veo capture records them, or pictures cam0001/*.png, ...; pictures
        of the same name were taken at the same moment.
    out
        folder for calibration.json, calibrate.json, pictures and calibrate.html; an interrupted run goes on from there.
    squares
        columns x rows of the board.
    square_mm
        side of a square; measure the print, all lengths come from it.
    marker_mm
        side of a marker's black square.
    dictionary
        OpenCV's name of the markers' dictionary.
    legacy
        the board has the pattern of OpenCV before 4.6.
    lenses
        a calibration.json whose lenses are kept; only the places are found then.
    coefficients
        how many of OpenCV's distortion numbers a lens has: 0, 4, 5, 8 or 12.
    without
        cameras, or devices with all their cameras, to leave out.
    """
    from veo_ti.footage.calibrating import board_of, calibrate_folder
    from veo_ti.progress import waiting

    board = board_of(squares, square_mm, marker_mm, dictionary, legacy)
    with waiting("calibrate") as say:
        return calibrate_folder(
            folder, out, board, lenses=lenses, coefficients=coefficients, without=without or [], say=say
        )


def track(
    folder: Folder,
    *,
    out: Path | None = None,
    marker_id: int = 164,
    marker_mm: float = 40.0,
    dictionary: str = "DICT_ARUCO_MIP_36h12",
    camera: list[str] | None = None,
    replace: Annotated[bool, Parameter(negative="")] = False,
) -> dict[str, object]:
    """Follow the air nozzle's ArUco marker through all cameras that see it.

    Parameters
    ----------
    folder
        a PLUSH object folder with videos and calibration.json.
    out
        folder for aruco_path.json, track.npz, pictures and track.html; FOLDER/track when not given.
    marker_id
        the marker's number in its dictionary.
    marker_mm
        side of its black square.
    dictionary
        OpenCV's name of its dictionary.
    camera
        follow it with this camera, and others named so; with all that show it when not given.
    replace
        write over a capture/aruco_path.json that is there; without it such a file is kept, unless it knows no pose.
    """
    from recon.marker import Marker
    from veo_ti.footage.tracking import track_folder
    from veo_ti.progress import waiting

    marker = Marker(id=marker_id, side=marker_mm / 1e3, dictionary=dictionary)
    with waiting("track") as say:
        return track_folder(folder, out, marker=marker, replace=replace, only=camera or [], say=say)


def matte(
    folder: Folder,
    *,
    out: Path | None = None,
    plate_frame: str | None = None,
    plates: Path | None = None,
    network: Path | None = None,
    threshold: float | None = None,
    quick: Annotated[bool, Parameter(negative="")] = False,
    keep_nozzle: Annotated[bool, Parameter(negative="")] = False,
    camera: list[str] | None = None,
) -> dict[str, object]:
    """Cut the object out of every frame, into capture/mattes.

    Without a plate, the picture of the empty scene, the object is what is brighter than the dark cloth. Where the
    nozzle's path is known, the nozzle is cut out as well.

    Parameters
    ----------
    folder
        a PLUSH object folder with videos.
    out
        folder for mattes.json, pictures and matte.html; FOLDER/matte when not given.
    plate_frame
        frame of the recording that shows no object, or several such as 0-30.
    plates
        folder with the empty scene: NAME.png, pictures NAME/*.png, or videos; kept in capture/plates.
    network
        an .onnx file of a matting network, in place of plate difference and brightness.
    threshold
        of 255: what is brighter, or differs by more from the plate, is the object; the noise decides when not given.
    quick
        hard edges, much faster.
    keep_nozzle
        do not cut the nozzle out.
    camera
        this camera, and others named so; all colour ones when not given.
    """
    from veo_ti.footage.matte_cut import MatteChoice
    from veo_ti.footage.mattes import matte_folder
    from veo_ti.progress import waiting

    choice = MatteChoice(
        plate_frame=plate_frame, plates=plates, network=network, threshold=threshold, quick=quick, nozzle=keep_nozzle
    )
    with waiting("matte") as say:
        return matte_folder(folder, choice, out, only=camera or [], say=say)
