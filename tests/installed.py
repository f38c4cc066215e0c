"""Test what users get: python tests/installed.py dist [pytest's arguments].

The sdist is unpacked in a temporary directory, its sources are taken away, the wheel is installed into a fresh virtual
environment, and a suite and the sdist's tests, the pages for users among them, run there. The other packages are those
of the environment that this runs in: nothing is downloaded.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import venv
from pathlib import Path


def only(folder: Path, pattern: str) -> Path:
    """The one file of that pattern; exits with what is there otherwise."""
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        raise SystemExit(f"{folder}: {len(found)} files {pattern}, expected one; `make dist` builds them")
    return found[0].resolve()


def run_suite(binaries: Path, folder: Path, environment: dict[str, str]) -> None:
    """The benchmarks of the wheel, from a directory that is no checkout: run, report, study, in both ways to say it."""
    folder.mkdir()
    steerkit, benchmarks = [binaries / "steerkit", "bench"], [binaries / "python", "-m", "benchmarks"]
    for command in (
        [*steerkit, "run", "golden", "--only", "stanley", "--jobs", "2", "--quiet", "--json", "--out", "results"],
        [*benchmarks, "run", "golden", "--only", "stanley", "--jobs", "1", "--quiet", "--out", "again"],
        [*steerkit, "compare", "results", "again", "--strict"],
        [*benchmarks, "report", "results"],
        [*steerkit, "study", "throughput", "--quick", "--json"],
    ):
        subprocess.run(command, cwd=folder, env=environment, check=True, timeout=600.0)
    if not (folder / "results" / "report.html").is_file():
        raise SystemExit("the installed benchmarks wrote no report")
    told = subprocess.run(
        [*steerkit, "golden"], cwd=folder, env=environment, capture_output=True, text=True, timeout=60.0
    )
    if told.returncode != 2 or "which only a checkout has" not in told.stderr:
        raise SystemExit(f"`steerkit bench golden` did not say where its numbers are: {told.stderr}")


def main() -> int:
    """Unpack, install, look where it was installed, run the tests; returns pytest's exit code."""
    dist, *arguments = sys.argv[1:] or ["dist"]
    wheel, source = only(Path(dist), "*.whl"), only(Path(dist), "*.tar.gz")
    with tempfile.TemporaryDirectory(prefix="steerkit-installed-") as name:
        place = Path(name)
        with tarfile.open(source) as archive:
            archive.extractall(place, filter="data")
        tree = only(place, "steerkit_control-*")
        for package in ("steerkit", "benchmarks"):
            shutil.rmtree(tree / package)
        venv.create(place / "venv", with_pip=False)
        python = place / "venv" / "bin" / "python"
        asked = subprocess.run(
            [python, "-c", "import sysconfig; print(sysconfig.get_paths()['purelib'])"],
            capture_output=True,
            text=True,
            check=True,
        )
        # a path file of a path file is not read: an editable install over there stays there
        Path(asked.stdout.strip(), "others.pth").write_text(sysconfig.get_paths()["purelib"] + "\n", encoding="utf-8")
        install = ["-m", "pip", "--python", str(python), "install", "--quiet", "--no-index", "--no-deps"]
        subprocess.run(
            [sys.executable, *install, "--disable-pip-version-check", "--ignore-installed", str(wheel)], check=True
        )
        environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME")}
        where = "import benchmarks, steerkit; print(steerkit.__version__, steerkit.__file__, benchmarks.__file__)"
        said = subprocess.run(
            [python, "-c", where], cwd=tree, env=environment, capture_output=True, text=True, check=True
        )
        print(said.stdout.strip(), flush=True)
        if said.stdout.count(str(place / "venv")) != 2:
            raise SystemExit("the packages were not imported from where they were installed")
        for listed in (["courses"], ["vehicles", "rav4"]):
            subprocess.run([place / "venv" / "bin" / "steerkit", *listed], cwd=tree, env=environment, check=True)
        run_suite(place / "venv" / "bin", place / "elsewhere", environment)
        return subprocess.run([python, "-m", "pytest", *arguments], cwd=tree, env=environment, check=False).returncode


if __name__ == "__main__":
    raise SystemExit(main())
