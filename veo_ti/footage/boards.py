"""The board looked for in all cameras' pictures, kept file by file, and what is wrong where it is not found."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from recon.calibration.charuco import Board, BoardViews, find_board
from recon.calibration.shots import best_shots, of_shots
from recon.images import ImageFiles
from sim.checks import require
from veo_ti.footage.sources import Footage
from veo_ti.kept import kept, key_of

LOOKED = 240  # moments at which the board is looked for
USED = 60  # moments that the calibration rests on
SEEK_FROM = 40  # pictures apart, from which jumping to one is cheaper than decoding all before it
FOREIGN = 0.1  # share of foreign markers among all finds from which the board cannot be the right one
SCHEMA = 1


def board_views(board: Board, footage: Footage, folder: Path, say: Callable[[str], None]) -> list[BoardViews]:
    """What every camera saw of the board at the moments that tell most; finds are kept in the folder, camera by camera.

    Raises ValueError naming file and camera for a camera that never sees the board, saying what it sees instead.
    """
    looked = np.unique(np.linspace(0, footage.moments - 1, min(LOOKED, footage.moments)).round().astype(int))
    views = []
    for number, name in enumerate(footage.sources):
        say(f"{name}, {number + 1} of {len(footage.sources)}")
        views.append(_kept_views(board, footage, name, looked, folder))
        source = footage.sources[name]
        _require_board(board, views[-1], f"{name} pictures" if isinstance(source, ImageFiles) else source.label)
    shots = best_shots(views, USED)
    return [of_shots(seen, shots) for seen in views]


def spelled_board(board: Board) -> str:
    """The board in words."""
    sizes = f"{1e3 * board.square:g} mm with markers of {1e3 * board.marker:g} mm"
    pattern = " in OpenCV's older pattern" if board.legacy else ""
    return f"{board.columns} x {board.rows} squares of {sizes} of {board.dictionary}{pattern}"


def _kept_views(board: Board, footage: Footage, name: str, looked: np.ndarray, folder: Path) -> BoardViews:
    source = footage.sources[name]
    key = key_of(SCHEMA, source.identity, footage.moment[name], looked, *asdict(board).values())

    def find() -> dict[str, np.ndarray]:
        seen = find_board(board, source.label, _images(footage, name, looked))
        parts = {part: getattr(seen, part) for part in ("size", "shot", "corner", "pixel", "markers", "foreign")}
        return {part: np.asarray(value) for part, value in parts.items()}

    held = kept(folder / f"{name}.npz", key, find)
    return BoardViews(
        name=name,
        size=tuple(held["size"].tolist()),
        shots=len(looked),
        shot=looked[held["shot"]],
        corner=held["corner"],
        pixel=held["pixel"],
        markers=int(held["markers"]),
        foreign=held["foreign"],
    )


def _images(footage: Footage, name: str, looked: np.ndarray) -> Iterator[np.ndarray | None]:
    """The camera's picture at each moment looked at, None where it took none; far ones are jumped to."""
    source, moment = footage.sources[name], footage.moment[name]
    at = np.searchsorted(moment, looked).clip(max=len(moment) - 1)
    wanted = [int(i) if moment[i] == m else None for i, m in zip(at, looked, strict=True)]
    jumping = isinstance(source, ImageFiles) or len(moment) > SEEK_FROM * len(looked)
    following, place = source.frames(), 0
    for picture in wanted:
        if picture is None:
            yield None
        elif jumping:
            yield next(source.frames(picture, picture + 1))
        else:
            for _ in range(picture - place):
                next(following)
            place = picture + 1
            yield next(following)


def _require_board(board: Board, seen: BoardViews, label: str) -> None:
    total = seen.markers + len(seen.foreign)
    rule = f"show the board of {spelled_board(board)}"
    got = f"markers up to id {seen.foreign.max(initial=0)} where that board has 0 to {board.markers - 1}"
    require(len(seen.foreign) <= FOREIGN * total, label, rule, got)
    got = f"none of its markers in any of {seen.shots} pictures"
    if seen.markers:
        got = "its markers in another order: columns and rows may be swapped, or the pattern OpenCV's older one"
    require(len(seen.shot) > 0, label, rule, got)


def tiles(views: Sequence[BoardViews], width: int = 220) -> dict[str, np.ndarray]:
    """A small picture of every camera, RGB uint8, with a dot wherever a corner was seen."""
    shown = {}
    for seen in views:
        height = max(1, round(width * seen.size[1] / seen.size[0]))
        tile = np.full((height, width, 3), (226, 228, 228), np.uint8)
        column, row = np.round(seen.pixel * [width / seen.size[0], height / seen.size[1]]).astype(int).T
        for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
            tile[(row + down).clip(0, height - 1), (column + right).clip(0, width - 1)] = (11, 122, 117)
        shown[seen.name] = tile
    return shown
