"""Write the software bill of materials: every package of constraints.txt, as CycloneDX 1.6 in JSON.

    python tools/bill_of_materials.py

The bill depends on constraints.txt, pyproject.toml, and the version of nsm alone, so that it is the same everywhere.

References:
    CycloneDX 1.6, https://cyclonedx.org/docs/1.6/json/
    Package URLs of PyPI, https://github.com/package-url/purl-spec
"""

from __future__ import annotations

import json
import tomllib
import uuid
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import nsm
from nsm.cli.files import atomic_write

ROOT = Path(__file__).resolve().parents[1]
BILL = ROOT / "sbom.cdx.json"


def main() -> None:
    """Write the bill."""
    with atomic_write(BILL) as temporary:
        temporary.write_text(bill_of_materials())
    print(f"wrote {BILL.name}, {len(pins())} packages")


def pins() -> dict[str, str]:
    """Versions of constraints.txt by canonical name, in the order of the names."""
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pairs = (line.split("==") for line in lines if line and not line.startswith("#"))
    return dict(sorted((canonicalize_name(name), version) for name, version in pairs))


def bill_of_materials() -> str:
    """The bill as the text of its file."""
    urls = {name: f"pkg:pypi/{name}@{version}" for name, version in pins().items()}
    own = f"pkg:pypi/nsm@{nsm.__version__}"
    bill: dict[str, Any] = {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": own,
                "name": "nsm",
                "version": nsm.__version__,
                "licenses": [{"license": {"id": "MIT"}}],
                "purl": own,
            }
        },
        "components": [
            {"type": "library", "bom-ref": urls[name], "name": name, "version": version, "purl": urls[name]}
            for name, version in pins().items()
        ],
        "dependencies": [{"ref": own, "dependsOn": sorted(urls[name] for name in _direct() if name in urls)}],
    }
    # a number of its own for every content, as the format asks for, and the same for the same content
    bill["serialNumber"] = uuid.uuid5(uuid.NAMESPACE_URL, json.dumps(bill, sort_keys=True)).urn
    return json.dumps(bill, indent=2) + "\n"


def _direct() -> set[str]:
    """Names of the packages that pyproject.toml requires, in the core or in an extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = [*project["dependencies"], *(line for extra in project["optional-dependencies"].values() for line in extra)]
    return {canonicalize_name(Requirement(line).name) for line in lines}


if __name__ == "__main__":
    main()
