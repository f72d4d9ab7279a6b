"""What `veo coupon` does: read, diagnose with a spinner, write into a folder."""

from pathlib import Path

from rich.console import Console

from veo_ti.coupons.dogbone import examine_dogbone, is_dogbone, read_dogbone
from veo_ti.coupons.dogbone_report import write_dogbone
from veo_ti.coupons.reading import read_coupon
from veo_ti.coupons.report import write_coupon
from veo_ti.coupons.run import diagnose_coupon
from veo_ti.store import writable_folder

console = Console(stderr=True)


def coupon_source(source: str, out: Path, *, fit: str | None, up_to: float | None) -> dict[str, object]:
    """The facts of the written folder. Raises ValueError in one sentence."""
    writable_folder(out)
    if is_dogbone(source):
        facts = write_dogbone(examine_dogbone(read_dogbone(source)), out)
    else:
        coupon = read_coupon(source)
        modes = None if fit is None else [mode.strip().upper() for mode in fit.split(",")]
        with console.status("every cause") as status:
            found = diagnose_coupon(coupon, modes=modes, up_to=up_to, progress=status.update)
        facts = write_coupon(found, out)
    console.print(facts["sentence"], markup=False)
    return facts
