"""What the docs name exists: files, tests, paths, links and commits, and what services take."""

import re
import subprocess
from pathlib import Path

import pytest
from catkin_pkg.package import parse_package

from im_pnt.netfile import load_net

ROOT = Path(__file__).resolve().parent.parent
GUIDES = sorted(page for folder in (".", "tutorials") for page in (ROOT / "docs" / folder).glob("*.md"))
EVIDENCE = sorted((ROOT / "docs" / "evidence").glob("*.md"))
PACKAGES = sorted((ROOT / "ros_ws").glob("*/*/package.xml"))
PAGES = [
    *GUIDES,
    *EVIDENCE,
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
]


def places(name):
    """Where ``im_x/...`` may be: below the package's sources, or its tests; else below the root."""
    package, _, rest = name.partition("/")
    source = ROOT / "ros_ws" / "src" / package
    return (source / package / rest, source / rest) if source.is_dir() else (ROOT / name,)


def is_there(name):
    return any(place.exists() or any(place.parent.glob(place.name)) for place in places(name))


def test_each_row_of_the_paper_has_its_file_and_its_test():
    rows = [line.split("|") for line in (ROOT / "docs" / "paper.md").read_text().splitlines() if line.startswith("| ")]
    rows = [row for row in rows if not row[1].strip().startswith("in the paper")]
    assert len(rows) > 30
    for row in rows:
        tests = [name for name in re.findall(r"`([^`]+\.py)`", row[3]) if "/test_" in name]
        assert tests, f"no test in the row of {row[1]}"
        named = [name for cell in row[2:4] for name in re.findall(r"`([^`]+)`", cell)]
        missing = [name for name in named if re.search(r"\.(py|yaml)$|/$", name) and not is_there(name)]
        assert not missing, f"in the row of {row[1]}"


def test_each_fault_has_a_test_that_injects_it_and_asserts_what_the_user_reads():
    rows = [line.split("|") for line in (ROOT / "docs" / "errors.md").read_text().splitlines() if line.startswith("| ")]
    rows = [[cell.strip() for cell in row[1:-1]] for row in rows if row[1].strip() != "fault"]
    assert len(rows) >= 25
    assert len({row[0] for row in rows}) == len(rows)
    for fault, noticed, mended, lost, reads, test in rows:
        assert noticed, fault
        assert mended, fault
        assert lost, fault
        file, name = test.strip("`").split("::")
        text = (ROOT / file).read_text(encoding="utf-8")
        assert re.search(rf"^(async )?def {name}\(", text, re.MULTILINE), f"{fault}: there is no {test}"
        assert reads.strip("`") in text, f"{fault}: {file} does not assert {reads}"


def test_each_service_of_a_coordinator_has_its_row_with_all_its_arguments():
    text = (ROOT / "docs" / "nets.md").read_text()
    told = {}
    for line in re.findall(r"^\| (`\w+_coordinator\..+)$", text, re.MULTILINE):
        services, arguments, *_ = line.split("|")
        coordinator, *names = re.findall(r"\w+", services)
        told.update({(coordinator, name): set(re.findall(r"`(\w+)`", arguments)) for name in names})
    taken = {
        (net.name, name): set(service.arguments.arguments)
        for net in map(load_net, (ROOT / "ros_ws/src/im_coordinators/im_coordinators/nets").glob("*.yaml"))
        for name, service in net.services.items()
    }
    assert told.keys() == taken.keys()
    assert not {service: missing for service in taken if (missing := taken[service] - told[service])}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_paths_and_links_lead_somewhere(page):
    text = page.read_text()
    links = [link.partition("#")[0] for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link]
    assert not [link for link in links if link and not (page.parent / link).exists()]
    # Neither names of interfaces, such as im_msgs/srv/LoadNet, nor the page's own im_x.
    paths = re.findall(r"`((?:ros_ws|scripts|test|bench|docs|im_(?!msgs|x)[a-z_]+)/[\w./*-]+)`", text)
    paths = [path for path in paths if "/im_x/" not in path]
    assert not [path for path in paths if not is_there(path)]
    modules = re.findall(r"python -m ((?:im_[a-z_]+|bench)[\w.]*)", text)
    missing = []
    for module in modules:
        path = module.replace(".", "/")
        if not is_there(f"{path}.py") and not is_there(f"{path}/__main__.py"):
            missing.append(module)
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_pytest_is_to_select_is_there(page):
    for file, word in re.findall(r"pytest (\S+\.py) -k (\w+)", page.read_text()):
        assert re.search(rf"def test_\w*{word}", (ROOT / file).read_text()), f"{file} -k {word}"


@pytest.mark.skipif(not (ROOT / ".git").is_dir() or (ROOT / ".git" / "shallow").exists(), reason="no history here")
def test_commits_are_in_the_history():
    named = {commit for page in PAGES for commit in re.findall(r"commit `([0-9a-f]{7,40})", page.read_text())}
    command = ["git", "cat-file", "--batch-check"]
    told = subprocess.run(command, cwd=ROOT, input="\n".join(sorted(named)), capture_output=True, text=True, check=True)
    assert not [line for line in told.stdout.splitlines() if " commit " not in line]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.parent.name)
def test_the_maintainers_are_those_of_the_licence_at_no_example_address(package):
    """The domain that RFC 2606 reserves for it stands for no address; ``catkin_pkg`` accepts it."""
    (holder,) = re.findall(r"^Copyright \(c\) \d+ (.+)$", (ROOT / "LICENSE").read_text(), re.MULTILINE)
    (maintainer,) = parse_package(package).maintainers
    assert (maintainer.name, "example" in maintainer.email) == (holder, False)
    setup = package.parent / "setup.py"
    if setup.exists():
        assert f'maintainer="{holder}",\n    maintainer_email="{maintainer.email}"' in setup.read_text()


def test_each_message_of_the_troubleshooting_is_one_that_is_printed():
    sources = [*(ROOT / "ros_ws" / "src").glob("im*/im*/**/*.py"), *(ROOT / "scripts").glob("*")]
    text = "\n".join(source.read_text(encoding="utf-8") for source in sources if source.is_file())
    said = re.sub(r"\"\s*\n\s*f?\"", "", text)  # a sentence over several lines of code
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    messages = [row.split("|")[1].strip() for row in page.splitlines() if row.startswith("| ")]
    messages = [message for message in messages if message != "message"]
    assert len(messages) > 15
    assert not [message for message in messages if message not in said]


def test_files_of_the_docs_that_programs_name_exist():
    sources = [*ROOT.glob("ros_ws/src/*/im*/**/*.py"), *ROOT.glob("bench/**/*.py"), *(ROOT / "scripts").iterdir()]
    named = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in sources
        if path.is_file()
        for name in re.findall(r"\bdocs/[\w/]+\.\w+", path.read_text(encoding="utf-8"))
        if not (ROOT / name).exists()
    }
    assert not named
