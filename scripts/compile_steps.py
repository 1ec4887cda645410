"""Compile the Cython modules of the workspace, each beside its source; those whose source has not changed are left.

``.venv/bin/python scripts/compile_steps.py``; ``scripts/setup.sh`` runs it. Sums stay in the order of the source: without
fused multiply-add, and for the least processor, so that a run is the same to the last digit on each.
"""

import hashlib
import importlib.machinery
import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import Cython
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
BUILD = ROOT / "ros_ws" / "build" / "steps"
FLAGS = (
    "-O2",
    "-ffp-contract=off",
    "-fno-strict-aliasing",
    "-fPIC",
    "-shared",
    "-DNPY_NO_DEPRECATED_API=NPY_1_22_API_VERSION",
)
SUFFIX = importlib.machinery.EXTENSION_SUFFIXES[0]


def main() -> int:
    """Compile what has changed; return the exit code."""
    sources = sorted((ROOT / "ros_ws" / "src").glob("im_*/im_*/**/*.pyx"))
    compiler = subprocess.run(["gcc", "--version"], capture_output=True, text=True, check=True).stdout
    common = [*FLAGS, Cython.__version__, np.__version__, sys.version, compiler, Path(__file__).read_text("utf-8")]
    kept = {source.with_name(source.stem + SUFFIX) for source in sources}
    for stale in set((ROOT / "ros_ws" / "src").glob(f"im_*/im_*/**/*{SUFFIX}")) - kept:
        stale.unlink()
    for source in sources:
        key = hashlib.sha256("\0".join([*common, source.read_text("utf-8")]).encode()).hexdigest()
        compile_step(source, key)
    return 0


def compile_step(source: Path, key: str) -> None:
    """Compile one module, unless that of the same key is there.

    Raises:
        SystemExit: It does not compile; the message names the source, and has what the compiler said.
    """
    target = source.with_name(source.stem + SUFFIX)
    stamp = BUILD / f"{source.parent.name}.{source.stem}.key"
    if target.exists() and stamp.exists() and stamp.read_text("utf-8") == key:
        return
    BUILD.mkdir(parents=True, exist_ok=True)
    code, built = BUILD / f"{source.parent.name}.{source.stem}.c", BUILD / f"{key}{SUFFIX}"
    include = [f"-I{folder}" for folder in (sysconfig.get_paths()["include"], np.get_include())]
    for command in (
        [sys.executable, "-m", "cython", "-3", "-X", "boundscheck=False,wraparound=False,cdivision=True", "--module-name",
         ".".join(source.relative_to(ROOT / "ros_ws" / "src").parts[1:-1] + (source.stem,)), str(source), "-o", str(code)],
        ["gcc", *FLAGS, *include, str(code), "-o", str(built), "-lm"],
    ):  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"{source.relative_to(ROOT)} does not compile:\n{done.stdout}{done.stderr}")
    os.replace(built, target)
    stamp.write_text(key, "utf-8")
    print(f"compiled {source.relative_to(ROOT)}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
