"""A result as one HTML file: pictures inside it, nothing fetched, readable on a phone and on paper."""

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from recon.files import replacing
from sim.checks import require

KINDS = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".svg": "image/svg+xml", ".mp4": "video/mp4"}

STYLE = """
:root{--ink:#2b2d33;--soft:#6b6f7a;--line:#e3e3dd;--paper:#fbfbf9;--accent:#0b7a75}
*{box-sizing:border-box}
body{margin:0;background:var(--paper);color:var(--ink);font:17px/1.55 system-ui,-apple-system,"Segoe UI",sans-serif}
main{max-width:54rem;margin:0 auto;padding:2rem 1.1rem 4rem}
h1{font-size:1.7rem;line-height:1.2;margin:.4rem 0 .6rem}
h2{font-size:1.2rem;margin:2.4rem 0 .3rem;padding-top:1.1rem;border-top:1px solid var(--line)}
p{margin:.4rem 0}
.first{font-size:1.15rem;border-left:4px solid var(--accent);padding:.2rem 0 .2rem .9rem;margin:1rem 0}
.wide{overflow-x:auto;margin:.7rem 0}
table{border-collapse:collapse;font-size:.93rem;font-variant-numeric:tabular-nums}
th,td{padding:.35rem .9rem .35rem 0;text-align:left;border-bottom:1px solid var(--line);vertical-align:top}
th{color:var(--soft);font-weight:600}
.pictures{display:flex;flex-wrap:wrap;gap:.8rem;margin:.8rem 0}
figure{margin:0;flex:1 1 18rem;max-width:100%}
img,video{display:block;max-width:100%;max-height:36rem;height:auto;margin:0 auto;border-radius:6px}
figcaption{color:var(--soft);font-size:.85rem;text-align:center}
"""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows under column names; cells are shown as given, floats with four digits."""

    columns: Sequence[str]
    rows: Sequence[Sequence[object]]


@dataclass(frozen=True, kw_only=True)
class Section:
    """A heading, a line of plain language that says how to read what follows, then a table and pictures."""

    heading: str
    text: str
    table: Table | None = None
    pictures: Sequence[str | Path] = ()


def write_report(path: str | Path, title: str, sentence: str, sections: Sequence[Section]) -> Path:
    """Write the page: title, the one sentence that holds the result, then the sections.

    Pictures (.png, .jpg, .svg, .mp4) are embedded, named after their files. Written beside `path`, then renamed.
    Raises ValueError for a picture of another kind or a table whose rows do not fit its columns, OSError where a file
    cannot be read or written.
    """
    page = _page(title, sentence, sections)
    with replacing(path) as partial:
        partial.write_text(page, encoding="utf-8")
    return Path(path)


def _page(title: str, sentence: str, sections: Sequence[Section]) -> str:
    body = "\n".join(_section(section) for section in sections)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{STYLE}</style></head>\n"
        f'<body><main><h1>{html.escape(title)}</h1><p class="first">{html.escape(sentence)}</p>\n{body}\n'
        "</main></body></html>\n"
    )


def _section(section: Section) -> str:
    parts = [f"<h2>{html.escape(section.heading)}</h2>", f"<p>{html.escape(section.text)}</p>"]
    if section.table is not None:
        parts.append(_table(section.table))
    if section.pictures:
        parts.append('<div class="pictures">' + "".join(_picture(Path(p)) for p in section.pictures) + "</div>")
    return "\n".join(parts)


def _table(table: Table) -> str:
    for row in table.rows:
        require(len(row) == len(table.columns), "table rows", f"have {len(table.columns)} cells", list(row))
    head = "".join(f"<th>{html.escape(name)}</th>" for name in table.columns)
    rows = ["<tr>" + "".join(f"<td>{_cell(cell)}</td>" for cell in row) + "</tr>" for row in table.rows]
    return f'<div class="wide"><table><tr>{head}</tr>' + "".join(rows) + "</table></div>"


def _cell(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else html.escape(str(value))


def _picture(path: Path) -> str:
    kind = KINDS.get(path.suffix.lower())
    require(kind is not None, "pictures", f"end in one of {', '.join(KINDS)}", path)
    source = f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode()}"
    name = html.escape(path.stem.replace("_", " "))
    shown = f'<video controls loop muted src="{source}"></video>' if kind == "video/mp4" else \
        f'<img alt="{name}" src="{source}">'
    return f"<figure>{shown}<figcaption>{name}</figcaption></figure>"
