"""Licences of all packages of the environment that runs this script, as a table.

    build/dist/bin/python studies/licences.py > dist/LICENCES.md

Exits with 1 if a package declares no licence.
"""

from __future__ import annotations

import sys
from importlib.metadata import PackageMetadata, distributions

#: Part of every environment, not dependencies.
INSTALLERS = {"pip", "setuptools"}


def licence(metadata: PackageMetadata) -> str:
    """Return the declared licence; some packages put its whole text into the field."""
    text = metadata.get("License-Expression") or metadata.get("License") or ""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    if len(lines) == 1 and lines != ["UNKNOWN"]:
        return lines[0]
    classifiers = metadata.get_all("Classifier") or []
    classified = [c.rpartition(" :: ")[2] for c in classifiers if c.startswith("License ::")]
    return ", ".join(classified) or "".join(lines[:1])


def main() -> int:
    """Print the table."""
    found = {d.metadata["Name"]: d for d in distributions()}
    rows = {name: (d.version, licence(d.metadata)) for name, d in found.items()}
    print("| package | version | licence |\n|---|---|---|")
    for name, (version, declared) in sorted(rows.items(), key=lambda row: row[0].lower()):
        if name not in INSTALLERS:
            print(f"| {name} | {version} | {declared or 'none declared'} |")
    missing = [name for name, (_, declared) in rows.items() if not declared]
    if missing:
        print(f"no licence declared: {', '.join(missing)}", file=sys.stderr)
    return int(bool(missing))


if __name__ == "__main__":
    sys.exit(main())
