"""Stress-stretch files: what they hold becomes curves in SI units at this door."""

import csv
from importlib.resources import files
from pathlib import Path

import numpy as np

from sim.checks import as_array, require, some
from veo_ti.coupons.curves import NAMES, Coupon, Curve, principal
from veo_ti.store import read_npz

MEGA = 1e6
_TENSILE = ("eng_strain", "eng_stress_MPa")
_TABLE = ("mode", "stretch", "stress_MPa")


def read_coupon(source: str | Path) -> Coupon:
    """The word treloar; an .npz with `<mode>__F`, `<mode>__P` [MPa], `<mode>__stretch`; or a .csv.

    A .csv has the columns mode, stretch, stress_MPa, or (a machine's record of a tensile test) eng_strain and
    eng_stress_MPa. Raises ValueError in one sentence.
    """
    if str(source) == "treloar":
        return treloar()
    path = Path(source)
    require(
        path.suffix.lower() in (".npz", ".csv"), "coupon", "be an .npz, a .csv or the word treloar", repr(str(path))
    )
    require(path.is_file(), "file", "exist", repr(str(path)))
    if path.suffix.lower() == ".npz":
        return _from_arrays(path)
    return _from_text(path.stem, path.read_text(encoding="utf-8-sig", errors="replace"))


def treloar() -> Coupon:
    """Treloar's vulcanised rubber: Trans. Faraday Soc. 40 (1944) 59-70, as digitised by C. Zhao (MIT licence)."""
    table = files("veo_ti.coupons").joinpath("treloar_1944.csv").read_text(encoding="utf-8")
    return _from_text("Treloar 1944", table)


def _from_arrays(path: Path) -> Coupon:
    arrays = read_npz(path)
    modes = [mode for mode in NAMES if f"{mode}__stretch" in arrays]
    require(
        bool(modes), "coupon", f"hold <mode>__stretch for one of {', '.join(NAMES)}", ", ".join(arrays) or "nothing"
    )
    return Coupon(name=path.stem.replace("_", " "), curves=tuple(_curve(mode, arrays) for mode in modes))


def _curve(mode: str, arrays: dict[str, np.ndarray]) -> Curve:
    for key in (f"{mode}__F", f"{mode}__P"):
        require(key in arrays, "coupon", f"hold {key}", ", ".join(arrays))
    stretch = as_array(f"{mode}__stretch", arrays[f"{mode}__stretch"], (None,))
    F = as_array(f"{mode}__F", arrays[f"{mode}__F"], (len(stretch), 3, 3))
    P = as_array(f"{mode}__P", arrays[f"{mode}__P"], (len(stretch), 3, 3))
    require(bool((stretch > 0).all()), f"{mode}__stretch", "be positive", stretch.min() if len(stretch) else "nothing")
    off = np.abs(F - principal(mode, stretch)[:, :, None] * np.eye(3)).max(initial=0.0)
    require(off < 1e-3, f"{mode}__F", f"be the {NAMES[mode]} deformation of {mode}__stretch", f"{off:.3g} off")
    return Curve.of(mode, stretch, MEGA * P[:, 0, 0])


def _from_text(name: str, text: str) -> Coupon:
    rows = list(csv.DictReader(line for line in text.splitlines() if line.strip() and not line.startswith("#")))
    columns = tuple(rows[0]) if rows else ()
    if set(_TENSILE) <= set(columns):
        strain, stress = (_numbers(rows, column) for column in _TENSILE)
        back = np.flatnonzero(np.diff(strain) < 0)
        require(
            not len(back),
            "eng_strain",
            "grow throughout: unloading is not read",
            f"a step back in row {some(back[:1] + 3)}",
        )
        curve = Curve.of("UT", 1 + strain, MEGA * stress)
        return Coupon(name=name.replace("_", " "), curves=(curve,), crosshead=True)
    require(set(_TABLE) <= set(columns), "columns", f"hold {', '.join(_TABLE)} or {', '.join(_TENSILE)}",
            ", ".join(map(str, columns)) or "nothing")  # fmt: skip
    mode = np.array([row["mode"] for row in rows])
    stretch, stress = _numbers(rows, "stretch"), MEGA * _numbers(rows, "stress_MPa")
    return Coupon(
        name=name, curves=tuple(Curve.of(m, stretch[mode == m], stress[mode == m]) for m in dict.fromkeys(mode))
    )


def _numbers(rows: list[dict[str, str]], column: str) -> np.ndarray:
    values = []
    for number, row in enumerate(rows, start=2):
        try:
            values.append(float(row[column]))
        except (TypeError, ValueError):
            raise ValueError(f"{column} must be a number in every row; got {row[column]!r} in row {number}") from None
    return as_array(column, values, (None,))
