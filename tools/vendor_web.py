"""The libraries of the web page, as their authors publish them: `python tools/vendor_web.py` compares, `--fetch` gets them by npm.

Files lie unchanged in `clients/web/vendor/<name>-<version>/`, each folder with the licence and a `VENDOR.toml` that says where they come
from and what their bytes are. Comparing needs no network.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

VENDOR = Path(__file__).resolve().parent.parent / "clients/web/vendor"
PACKAGES = {
    "three": (
        "0.187.0",
        "MIT",
        (
            "LICENSE",
            "build/three.core.js",
            "build/three.module.js",
            "examples/jsm/controls/OrbitControls.js",
            "examples/jsm/loaders/GLTFLoader.js",
            "examples/jsm/utils/BufferGeometryUtils.js",
            "examples/jsm/utils/SkeletonUtils.js",
        ),
    ),
    "uplot": ("1.6.32", "MIT", ("LICENSE", "dist/uPlot.esm.js", "dist/uPlot.min.css")),
}


def digest(data: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def fetch(name: str) -> None:
    """The files of one package, out of the tarball that npm gets and checks."""
    version, licence, files = PACKAGES[name]
    folder = VENDOR / f"{name}-{version}"
    with tempfile.TemporaryDirectory() as place:
        subprocess.run(
            ["npm", "pack", "--silent", f"{name}@{version}"], cwd=place, check=True, stdout=subprocess.DEVNULL
        )
        tarball = next(Path(place).glob("*.tgz"))
        lines = [
            f'name = "{name}"',
            f'version = "{version}"',
            f'licence = "{licence}"',
            f'source = "npm package {name}, {tarball.name}"',
            f'sha256 = "{digest(tarball.read_bytes())}"',
            "",
            "[files]",
        ]
        with tarfile.open(tarball) as archive:
            for file in files:
                member = archive.extractfile(f"package/{file}")
                if member is None:
                    raise SystemExit(f"{tarball.name} has no {file}")
                data = member.read()
                target = folder / file
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)
                lines.append(f'"{file}" = "{digest(data)}"')
    (folder / "VENDOR.toml").write_text("\n".join(lines) + "\n")


def faults(vendor: Path = VENDOR) -> list[str]:
    """What differs from what the `VENDOR.toml` files say: changed, missing or unlisted files."""
    found = []
    for folder in sorted(path for path in vendor.iterdir() if path.is_dir()):
        about = folder / "VENDOR.toml"
        if not about.is_file():
            found.append(f"{folder.name}: no VENDOR.toml")
            continue
        listed: dict[str, str] = tomllib.loads(about.read_text())["files"]
        present = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} - {"VENDOR.toml"}
        found += [f"{folder.name}/{name}: not in VENDOR.toml" for name in sorted(present - set(listed))]
        for name, expected in listed.items():
            if name not in present:
                found.append(f"{folder.name}/{name}: missing")
            elif digest((folder / name).read_bytes()) != expected:
                found.append(f"{folder.name}/{name}: not the published bytes")
    return found


def main() -> int:
    """Fetch if asked, then compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fetch", action="store_true", help="get the files by npm")
    if parser.parse_args().fetch:
        for name in PACKAGES:
            fetch(name)
    found = faults()
    print("\n".join(found) or "vendored files are as published")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
