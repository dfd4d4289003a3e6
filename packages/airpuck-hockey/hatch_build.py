"""Pins airpuck: both distributions have one version."""

from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface


class Pinned(MetadataHookInterface):
    """Requires the airpuck of this version; its public names may change with every version."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the dependencies."""
        metadata["dependencies"] = [
            f"airpuck=={metadata['version']}",
            "numpy>=2.0",
            "scipy>=1.13",
            "jaxtyping>=0.3",
            "pydantic>=2.10",
            "typer>=0.29",
            "rich>=13",
            "websockets>=14",
        ]
