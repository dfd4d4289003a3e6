"""Fits, how well they predict, and what they are compared with: what a report shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from airpuck.data.trajectory import Span, Trajectory
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.evaluation.evaluate import Evaluation, hold_for, prediction_errors
from airpuck.identification.fit_result import Fit
from airpuck.identification.objective import PUBLISHED_WEIGHTS
from airpuck.model.model_file import Model


@dataclass(frozen=True, eq=False)
class FitStudy:
    """Models of one craft, learned from one trajectory and judged on another."""

    #: What the models were learned from.
    training: Trajectory
    #: How they were learned.
    fits: tuple[Fit, ...]
    #: How well they predict, in the same order; can be empty.
    fitted: tuple[Evaluation, ...] = ()
    #: What they are compared with, by name of the rung.
    reference: Mapping[str, Model] = field(default_factory=dict)
    #: How well the reference predicts.
    reference_evaluations: tuple[Evaluation, ...] = ()
    #: What the reference is, in a word.
    reference_label: str = "published"
    #: Known faults of the recording that the models are judged on.
    faults: tuple[Span, ...] = ()

    @property
    def models(self) -> list[Model]:
        """The models that were learned."""
        return [fit.model for fit in self.fits]

    @cached_property
    def reference_losses(self) -> dict[str, float]:
        """Loss of each reference model on the windows of the fit of the same name.

        Each reference is evaluated with its own conventions of encoder and frame.
        """
        losses = {}
        for fit in self.fits:
            model, settings = self.reference.get(fit.model.name), fit.model.fit
            if model is None:
                continue
            encoder = PaperEncoder(settings.get("encoder_length", 20), model.indexing)
            windows = hold_for(
                model,
                make_windows(
                    self.training,
                    encoder.length,
                    settings.get("prediction_length", 50),
                    settings.get("stride", 7),
                ),
            )
            errors = prediction_errors(model.dynamics, windows, encoder)
            weights = np.array(settings.get("weights", PUBLISHED_WEIGHTS))[:, None]
            losses[fit.model.name] = float(np.mean((weights * errors) ** 2))
        return losses

    @cached_property
    def best(self) -> Evaluation:
        """The fitted model whose three errors are lowest on geometric average."""
        return min(self.fitted, key=lambda e: float(np.log(np.maximum(e.rmse, 1e-300)).sum()))


def protocol_words(evaluation: Evaluation) -> str:
    """Say in a sentence how errors were measured."""
    protocol = evaluation.protocol
    after = evaluation.horizon_step * evaluation.sample_period
    return (
        f"Protocol “{protocol.name}”: {evaluation.errors.shape[2]} windows that do not overlap, "
        f"of {protocol.encoder_length} samples for the encoder and {protocol.prediction_length} "
        f"steps to predict; errors after step {evaluation.horizon_step} ({after:.3f} s)."
    )
