"""The page and the curves: nothing is fetched, nothing is executed, the file is whole or absent."""

import re
from html.parser import HTMLParser

import imageio.v3 as iio
import numpy as np
import pytest

from veo_ti.plots import error_over_time
from veo_ti.report import Section, Table, write_report


class Reader(HTMLParser):
    """Collects the text, the addresses and the number of unclosed tags of a page."""

    def __init__(self, page: str):
        super().__init__()
        self.words, self.sources, self.open = [], [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.sources += [value for name, value in attrs if name in {"src", "href"}]
        if tag not in {"meta", "img"}:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def page_of(path, *sections) -> str:
    return write_report(path, "Beam & jet", "It is 3 mm off.", sections).read_text(encoding="utf-8")


def test_page_holds_everything_and_fetches_nothing(tmp_path):
    iio.imwrite(tmp_path / "mu_map.png", np.zeros((4, 4, 3), np.uint8))
    table = Table(columns=["case", "mm"], rows=[["model", 0.123456], ["rest", 9]])
    page = page_of(tmp_path / "r.html", Section(heading="Error", text="Smaller is better.", table=table,
                                                pictures=[tmp_path / "mu_map.png"]))
    reader = Reader(page)
    text = " ".join(reader.words)
    assert all(word in text for word in ("Beam & jet", "It is 3 mm off.", "Smaller is better.", "0.1235", "mu map"))
    assert all(source.startswith("data:image/png;base64,") for source in reader.sources) and len(reader.sources) == 1
    assert not re.search(r"https?://|@import|url\(", page) and reader.open == []


def test_words_cannot_become_markup(tmp_path):
    page = page_of(tmp_path / "r.html", Section(heading="<script>x</script>", text="a < b", table=Table(
        columns=["<b>"], rows=[["<i>"]])))
    assert not re.search(r"<script|<b>|<i>|a < b", page)


def test_failed_page_leaves_the_old_one(tmp_path):
    path = tmp_path / "r.html"
    old = page_of(path)
    with pytest.raises(FileNotFoundError):
        page_of(path, Section(heading="a", text="b", pictures=[tmp_path / "absent.png"]))
    assert path.read_text(encoding="utf-8") == old and [p.name for p in tmp_path.iterdir()] == ["r.html"]


@pytest.mark.parametrize(("section", "words"), [
    (Section(heading="a", text="b", pictures=["x.tiff"]), "pictures must end in"),
    (Section(heading="a", text="b", table=Table(columns=["a"], rows=[[1, 2]])), "table rows must have 1 cells"),
])
def test_bad_sections_are_named(tmp_path, section, words):
    with pytest.raises(ValueError, match=words):
        page_of(tmp_path / "r.html", section)


def test_curves_are_drawn_and_held_out_frames_shaded(tmp_path):
    time, ones = np.arange(8) / 10, np.ones(8)
    held_out = np.arange(8) >= 4
    shots = [
        iio.imread(error_over_time(time, ones, 2 * ones, 3 * ones, mask, 0.4, tmp_path / f"{i}.png", load=ones))
        for i, mask in enumerate((np.zeros(8, bool), held_out))
    ]
    row = shots[0].shape[0] // 2
    changed = abs(shots[1][row].astype(int) - shots[0][row]).max(axis=-1) > 3
    width = len(changed)
    assert changed[int(0.6 * width) : int(0.85 * width)].mean() > 0.8 and not changed[: int(0.4 * width)].any()


def test_curves_of_wrong_length_are_named(tmp_path):
    with pytest.raises(ValueError, match="one homogeneous material must have shape"):
        error_over_time(np.arange(3), np.ones(3), np.ones(4), np.ones(3), np.zeros(3, bool), None, tmp_path / "x.png")
