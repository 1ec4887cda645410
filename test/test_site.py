"""docs/ is built as a site without a warning, and leads to each of its pages; what it cannot follow are no links."""

import re
import subprocess
import sys

import pytest

from support.whole_machine import ROOT

DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the built site."""
    folder = tmp_path_factory.mktemp("site")
    argv = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(argv, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert not re.findall(r"^WARNING.*", done.stderr, re.MULTILINE)
    return folder


def test_every_page_is_in_the_site_and_in_its_navigation(site):
    told = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    pages = [page.relative_to(DOCS) for page in DOCS.rglob("*.md")]
    assert len(pages) > 30
    for page in pages:
        assert f": {page}\n" in told
        place = page.parent if page.name == "index.md" else page.with_suffix("")
        assert (site / place / "index.html").is_file(), page


def test_no_link_of_a_page_leads_out_of_the_site(site):
    """Neither to files of the workspace nor to other servers: a font, a script."""
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for target in re.findall(r"<(?:a|img)[^>]* (?:href|src)=\"?([^\">\s#]+)", text):
            if "://" not in target and page.name != "404.html":
                there = (page.parent / target).resolve()
                assert there.exists(), f"{page.relative_to(site)}: {target}"
                assert there.is_relative_to(site)
        loaded = re.findall(r"<(?:script|link)[^>]* (?:src|href)=\"?(https?://[^\">\s]+)", text)
        assert [each for each in loaded if "canonical" not in each] == []


def test_the_links_between_pages_stay(site):
    home = (site / "index.html").read_text(encoding="utf-8")
    for page in ("tutorials/net/", "concepts/", "troubleshooting/", "operation/#look-at-it"):
        assert re.search(rf'href="?{page}', home), page
