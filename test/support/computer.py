"""A clean clone on a computer with few programs."""

import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TOOLS = """
awk basename bash cat cp cut df dirname env find flock grep head ls mkdir mktemp mv nproc rm sed sha256sum sort tail
touch uname wc xargs
"""


class Computer:
    """A clone of the scripts and what they read; programs are what the test adds to a dozen of the shell's."""

    def __init__(self, folder):
        self.root, self.bin = folder / "clone", folder / "bin"
        self.bin.mkdir()
        shutil.copytree(ROOT / "scripts", self.root / "scripts")
        shutil.copy(ROOT / "requirements.lock", self.root)
        for folder in ("src", "standard_msgs"):
            (self.root / "ros_ws" / folder).mkdir(parents=True)
        variables = Path("ros_ws/src/im_bringup/im_bringup/config/environment.txt")
        (self.root / variables.parent).mkdir(parents=True)
        shutil.copy(ROOT / variables, self.root / variables)
        for tool in TOOLS.split():
            self.add(tool, Path(shutil.which(tool)))

    def add(self, name, target):
        (self.bin / name).symlink_to(target)

    def write(self, name, text):
        path = self.bin / name
        path.unlink(missing_ok=True)
        path.write_text(f"#!/bin/sh\n{text}\n")
        path.chmod(0o755)

    def run(self, name, *arguments, **environment):
        path = self.root / "scripts" / f"{name}.sh"
        environment = {"PATH": str(self.bin), "HOME": str(self.root), **environment}
        argv = [str(self.bin / "bash"), str(path), *arguments]
        return subprocess.run(argv, env=environment, capture_output=True, text=True, timeout=60, check=False)

    def add_compilers(self):
        for compiler in ("gcc", "g++"):
            self.write(compiler, "exit 0")

    def add_python(self, name, during=""):
        """A Python that makes environments of itself, and does nothing but write down how it was called, in ``calls``.

        Args:
            name: Of the program.
            during: Shell commands that it runs in each call.
        """
        self.write(
            name,
            f"""echo "$0 $*" >>{self.root}/calls
{during}
case "$*" in
  "-m venv "*)
    for folder; do :; done
    mkdir -p "$folder/bin" && cp "$0" "$folder/bin/python" && cp "$0" "$folder/bin/uv" ;;
  *colcon\\ build*) echo : >install/setup.bash ;;
  *underlay.py*) echo : >"$2/local_setup.bash" ;;
  *message_cache.py\\ key*) echo key ;;
  *message_cache.py\\ fetch*) exit 1 ;;
esac""",
        )

    @property
    def calls(self):
        return (self.root / "calls").read_text().splitlines()

    def called(self, text):
        """The one call with this text in it."""
        found = [call for call in self.calls if text in call]
        assert len(found) == 1, (text, self.calls)
        return found[0]
