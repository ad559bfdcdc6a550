"""Where the configuration lies: inside the package once installed, beside it in a checkout."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent

#: The folder of the YAML files, absolute, as `hydra.main(config_path=str(CONF))` takes it.
CONF: Path = _PACKAGE / "conf" if (_PACKAGE / "conf").is_dir() else _PACKAGE.parent / "conf"
