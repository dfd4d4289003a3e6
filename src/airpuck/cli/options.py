"""Options and arguments that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

Json = Annotated[
    Path | None,
    typer.Option(
        "--json", metavar="FILE", help="Write the figures as JSON; - for standard output."
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but results.")]
VehicleFile = Annotated[
    Path | None,
    typer.Option("--vehicle", metavar="FILE", help="Vehicle file; by default the paper's craft."),
]
TopicsFile = Annotated[
    Path | None,
    typer.Option("--topics", metavar="FILE", help="TOML file with the names of a bag's topics."),
]
Span = Annotated[
    tuple[float, float] | None,
    typer.Option("--span", metavar="A B", help="Part to use, as fractions of the length."),
]
TuningFile = Annotated[
    Path | None,
    typer.Option("--tuning", metavar="FILE", help="Controller tuning; by default the packaged."),
]
PageFolder = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="DIR", help="Write a page of figures, too."),
]
RecordingPath = Annotated[
    Path,
    typer.Argument(
        metavar="RECORDING",
        help="A bag folder, .mcap, folder of CSV files, data.pt, or preprocessed .npz.",
    ),
]
ModelName = Annotated[
    str,
    typer.Argument(
        metavar="MODEL", help="A model.toml, the authors' params.json, or paper:M0 … M4."
    ),
]
TwinFile = Annotated[
    Path | None,
    typer.Option(
        "--twin", metavar="FILE", help="Table, sensors, radio, faults; by default the packaged."
    ),
]
Seed = Annotated[int, typer.Option(metavar="N", help="Seed of everything random.", min=0)]
ProtocolName = Annotated[
    Literal["paper", "paper-long", "causal"],
    typer.Option(
        "--protocol",
        help="paper; paper-long: encoders may look further back; causal: nothing measured later.",
    ),
]
EncoderName = Annotated[
    Literal["paper", "actuation"],
    typer.Option("--encoder", help="paper; actuation: estimates what each motor really does, too."),
]
