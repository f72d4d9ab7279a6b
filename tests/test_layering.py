"""The architecture as a table: who may import whom, and the rules that only the source shows."""

import ast
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("sim", "recon", "veo_ti")
LONGEST = 250

SIM_ORDER = (
    "runtime", "dtypes", "checks", "_open3d", "blocks", "lame", "laws", "hull", "consistency", "cloud", "join",
    "pattern", "dissection", "multifrontal", "stencil", "material", "elastic", "resolution", "occlusion", "terms",
    "energy", "twolevel", "linear", "direct", "solvers", "newton", "gradual", "vibration", "dynamics",
    "fixed_point", "follower", "rest_shape", "adjoint", "sensitivity", "through_time", "recollection", "prior",
    "basis", "evidence", "target", "fit", "adam",
)
SIM_FORBIDS = {"recon", "veo_ti", "torch", "h5py", "cv2", "pyvista", "rich", "cyclopts"}
RECON_MAY_USE = {"sim.runtime", "sim.dtypes", "sim.checks"}
# Where the import has another name than the package.
PYPI = {"cv2": "opencv_python_headless", "skimage": "scikit_image", "vtkmodules": "pyvista"}
MAY_PRINT = {"veo_ti.cli"}
MAY_START_TAICHI = {"sim.runtime"}


def modules() -> dict[str, str]:
    """Source text of every module of the three packages, by dotted name."""
    found = {}
    for path in (p for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py"))):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        found[name.removesuffix(".__init__")] = path.read_text(encoding="utf-8")
    return found


def imports(tree: ast.Module, known: Mapping[str, str]) -> Iterator[str]:
    """Dotted names that a module imports, wherever in the file; `from a import b` is a.b where that is a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            yield from (f"{base}.{a.name}" if f"{base}.{a.name}" in known else base for a in node.names)


def edge_fault(importer: str, imported: str) -> str | None:
    """Why this import is not allowed, or None."""
    package, target = importer.split(".")[0], imported.split(".")[0]
    if package == "sim" and target in SIM_FORBIDS:
        return f"{importer} imports {imported}: sim knows points, forces and energies only"
    if package == "recon" and (target == "veo_ti" or (target == "sim" and imported not in RECON_MAY_USE)):
        return f"{importer} imports {imported}: recon may use {sorted(RECON_MAY_USE)} only"
    if package == target == "sim" and importer != "sim" and not stands_before(imported, importer):
        return f"{importer} imports {imported}, which does not stand before it in sim"
    return None


def stands_before(imported: str, importer: str) -> bool:
    """True when sim's order lets `importer` see `imported`; modules of one sub-package may see each other."""
    names = [name.split(".")[1] if "." in name else "" for name in (imported, importer)]
    if not all(name in SIM_ORDER for name in names):
        return False
    first, second = map(SIM_ORDER.index, names)
    return first < second or (first == second and imported != importer)


def cycle(edges: Mapping[str, set[str]]) -> list[str]:
    """Modules that import one another in a ring, directly or not; empty when there are none."""
    left = {name: set(targets) for name, targets in edges.items()}
    while free := [name for name, targets in left.items() if not targets & left.keys()]:
        for name in free:
            del left[name]
    return sorted(left)


def calls(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Dotted names of called functions, with their lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func), node.lineno


def defines_kernel(tree: ast.Module) -> bool:
    """True when a function carries ti.kernel, ti.func or ti.real_func, called or not."""
    marks = [ast.unparse(d) for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) for d in n.decorator_list]
    return any(mark.split("(")[0] in {f"{ti}{kind}" for ti in ("ti.", "taichi.", "") for kind in
                                      ("kernel", "func", "real_func")} for mark in marks)


def faults(name: str, source: str, known: Mapping[str, str]) -> list[str]:
    """Every rule this source breaks, one sentence each."""
    tree = ast.parse(source)
    found = [fault for target in imports(tree, known) if (fault := edge_fault(name, target))]
    found += [f"{name} has {n} lines, more than {LONGEST}" for n in [len(source.splitlines())] if n > LONGEST]
    for called, line in calls(tree):
        if called in {"ti.init", "taichi.init"} and name not in MAY_START_TAICHI:
            found.append(f"{name}:{line} calls {called}: only sim.runtime starts Taichi")
        if called == "print" and name not in MAY_PRINT:
            found.append(f"{name}:{line} prints: only the command line speaks")
    for node in ast.walk(tree):
        if isinstance(node, ast.ExceptHandler) and node.type is None:
            found.append(f"{name}:{node.lineno} has a bare except")
        if isinstance(node, ast.ImportFrom) and any(alias.name == "*" for alias in node.names):
            found.append(f"{name}:{node.lineno} imports *")
        if isinstance(node, ast.ImportFrom) and node.level:
            found.append(f"{name}:{node.lineno} imports by dots: write the full name")
        if isinstance(node, ast.ImportFrom) and node.module == "__future__" and defines_kernel(tree):
            found.append(f"{name}:{node.lineno} postpones annotations, which breaks Taichi kernels")
    return found


KNOWN = modules()


@pytest.mark.parametrize("name", KNOWN)
def test_module_keeps_the_rules(name):
    assert faults(name, KNOWN[name], KNOWN) == []


def test_sim_modules_are_all_in_the_table():
    assert {name.split(".")[1] for name in KNOWN if name.startswith("sim.")} <= set(SIM_ORDER)


def test_every_imported_package_is_declared():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    needed = text[text.index("\ndependencies = [") : text.index("[project.optional-dependencies]")]
    declared = {name.replace("-", "_") for name in re.findall(r'^    "([\w-]+)', needed, re.MULTILINE)}
    used = {target.split(".")[0] for source in KNOWN.values() for target in imports(ast.parse(source), KNOWN)}
    foreign = {PYPI.get(name, name) for name in used - set(PACKAGES) - set(sys.stdlib_module_names)}
    assert foreign <= declared


def test_no_module_imports_itself_in_a_ring():
    edges = {name: set(imports(ast.parse(source), KNOWN)) for name, source in KNOWN.items()}
    assert cycle(edges) == []


BROKEN = {
    "sim sees torch": ("sim.fit", "import torch"),
    "sim sees torch inside a function": ("sim.fit", "def f():\n    from torch import nn"),
    "sim sees the package above": ("sim.checks", "from veo_ti import view"),
    "sim looks ahead": ("sim.cloud", "from sim.newton import equilibrate"),
    "an import by dots": ("sim.newton", "from .cloud import RestCloud"),
    "sim looks ahead through the package": ("sim.cloud", "from sim import newton"),
    "a law sees a term": ("sim.laws.neo_hookean", "import sim.terms.loads"),
    "a module without a place": ("sim.helpers", "import sim.checks"),
    "recon sees an energy": ("recon.warp", "from sim.energy import Energy"),
    "recon sees the package above": ("recon.warp", "import veo_ti"),
    "a second start of Taichi": ("recon.warp", "import taichi as ti\nti.init(arch=ti.cpu)"),
    "postponed annotations": ("sim.elastic", "from __future__ import annotations\n@ti.kernel\ndef k(): pass"),
    "postponed annotations, called mark": ("sim.laws.a", "from __future__ import annotations\n@ti.func()\ndef k(): 0"),
    "too long": ("sim.cloud", "x = 1\n" * 251),
    "bare except": ("veo_ti.store", "try:\n    pass\nexcept:\n    pass"),
    "a print": ("veo_ti.store", "print('hello')"),
    "a star": ("veo_ti.store", "from numpy import *"),
}
FINE = {
    "sim looks back": ("sim.newton", "from sim.energy import Energy\nimport numpy as np"),
    "siblings": ("sim.terms.loads", "from sim.terms.base import Term"),
    "a sub-package looks back": ("sim.terms.loads", "from sim import checks"),
    "recon sees the checks": ("recon.warp", "from sim.checks import require"),
    "the top sees all": ("veo_ti.pipeline", "import recon.warp, sim.fit, torch"),
    "the command line prints": ("veo_ti.cli", "print('hello')"),
    "postponed without kernels": ("veo_ti.store", "from __future__ import annotations"),
    "exactly long enough": ("sim.cloud", "x = 1\n" * 250),
}
SNIPPET_MODULES = {name: "" for name in ("sim.newton", "sim.checks", "sim.terms.base", "veo_ti.view")}


@pytest.mark.parametrize("case", BROKEN)
def test_checker_sees_the_broken_rule(case):
    assert len(faults(*BROKEN[case], SNIPPET_MODULES)) == 1


@pytest.mark.parametrize("case", FINE)
def test_checker_passes_what_is_allowed(case):
    assert faults(*FINE[case], SNIPPET_MODULES) == []


def test_checker_sees_a_ring():
    assert cycle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}, "e": set()}) == ["a", "b", "c", "d"]
