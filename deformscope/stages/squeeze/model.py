"""A trained classifier of contents: everything a new squeeze needs, as arrays."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.squeeze.components import Scaling, fit_scaling, kept_of, loadings
from deformscope.stages.squeeze.evaluation import Progress, held_values
from deformscope.stages.squeeze.fusion import Expert, Pool, fit_expert, fit_pool, fuse
from deformscope.stages.squeeze.table import LabelledTable, absent


@dataclass(frozen=True, slots=True)
class ModalityModel:
    """The model of one modality: from features to a calibrated posterior.

    scaling: scaling of its p columns, q of which are used; centre: (q,), directions: (q, d) of the components; expert:
    classifier on these"""

    scaling: Scaling
    centre: FloatArray
    directions: FloatArray
    expert: Expert

    @property
    def columns(self) -> int:
        """p"""
        return len(self.scaling.used)

    def log_posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) of (n, p) features."""
        return self.expert.log_posterior((self.scaling.apply(features) - self.centre) @ self.directions)


@dataclass(frozen=True, slots=True)
class ContentModel:
    """Content of a container, from any of its modalities.

    labels: C contents; modalities: models by name; fusion: model that fuses these, in their order; steps: by modality
    one model for each step of the squeeze, `step_s` apart; step_fusion: model that fuses these, in their order, for
    each step, () = they are not fused
    settings: settings of the features, as stored with them: a squeeze must have the same
    promised: accuracy with its interval, as evaluated; provenance: versions and source"""

    labels: tuple[str, ...]
    modalities: Mapping[str, ModalityModel]
    fusion: Pool
    steps: Mapping[str, tuple[ModalityModel, ...]] = field(default_factory=dict)
    step_fusion: tuple[Pool, ...] = ()
    step_s: float = 0.1
    settings: Mapping[str, object] = field(default_factory=dict)
    promised: Mapping[str, object] = field(default_factory=dict)
    provenance: Mapping[str, object] = field(default_factory=dict)

    def predict_proba(self, features: Mapping[str, FloatArray]) -> FloatArray:
        """(n, C) posterior of (n, p) features by modality, C as in `labels`.

        A modality may be left out, or its row be all NaN: then the others decide. Raises InputError for an unknown
        modality, other numbers of columns, and a trial without features."""
        if unknown := [name for name in features if name not in self.modalities]:
            raise InputError(f"modalities out of {', '.join(self.modalities)}", ", ".join(unknown))
        if not features:
            raise InputError(f"features of {' or '.join(self.modalities)}", "none")
        counts = {len(values) for values in features.values()}
        if len(counts) > 1:
            raise InputError("as many rows in every modality", ", ".join(map(str, sorted(counts))))
        count = counts.pop()
        logs = np.zeros((len(self.modalities), count, len(self.labels)))
        present = np.zeros(logs.shape[:2], dtype=bool)
        for index, (name, model) in enumerate(self.modalities.items()):
            if name in features:
                values = features[name]
                present[index] = ~np.isnan(checked(name, values, model)).all(axis=1)
                logs[index, present[index]] = model.log_posterior(values[present[index]])
        if not present.any(axis=0).all():
            row = int(np.flatnonzero(~present.any(axis=0))[0])
            raise InputError("features of each trial", f"none at all in row {row + 1}")
        return np.exp(fuse(self.fusion, logs, present))

    def predict_step(self, modality: str, step: int, features: FloatArray) -> FloatArray:
        """(n, C) posterior from (n, p) features, this number of steps after the first contact; later ones than any in
        training are taken as the last. Raises InputError for a modality without steps."""
        if modality not in self.steps:
            raise InputError(f"a modality with steps: {', '.join(self.steps) or 'none'}", modality)
        return np.exp(self._log_step(modality, step, features))

    def predict_at(self, since_s: float, features: Mapping[str, FloatArray]) -> tuple[tuple[str, ...], FloatArray]:
        """(n, C) posterior this long after first contact from features (n, p) by modality, and the modalities that it
        uses. They are those that have steps, where their fusion was learned; else `tactile` alone. A row of NaN is
        missing."""
        step = round(since_s / self.step_s)
        known = tuple(name for name in self.steps if name in features)
        if len(known) < 2 or not self.step_fusion:
            touch = features["tactile"]
            now = "tactile" in self.steps
            posterior = self.predict_step("tactile", step, touch) if now else self.predict_proba({"tactile": touch})
            return ("tactile",), posterior
        present = np.stack([~absent(features[name]) for name in known])
        logs = np.stack([self._log_step(name, step, np.nan_to_num(features[name])) for name in known])
        pool = self.step_fusion[min(step, len(self.step_fusion) - 1)]
        return known, np.exp(fuse(pool, logs, present))

    def _log_step(self, modality: str, step: int, features: FloatArray) -> FloatArray:
        models = self.steps[modality]
        model = models[min(step, len(models) - 1)]
        return model.log_posterior(checked(modality, features, model))


def checked(name: str, features: FloatArray, model: ModalityModel) -> FloatArray:
    """The same features (n, columns). Raises InputError for features that do not fit the model."""
    if features.ndim != 2 or features.shape[1] != model.columns:
        raise InputError(f"(n, {model.columns}) features in {name}, as in training", f"shape {features.shape}")
    if np.isinf(features).any():
        raise InputError(f"finite numbers in {name}", "infinity")
    return features


def fit_model(
    table: LabelledTable,
    *,
    by_group: bool,
    seed: int = 0,
    promised: Mapping[str, object] | None = None,
    provenance: Mapping[str, object] | None = None,
    progress: Progress | None = None,
) -> ContentModel:
    """A model trained on all trials, with the modalities that are fused and the method of the evaluation. by_group:
    groups are left out together when posteriors are calibrated and modalities weighed"""
    series = {name: held_values(values) for name, values in table.series.items()}
    table = table.of(table.fused[0])
    group = np.unique(table.group, return_inverse=True)[1].reshape(-1) if by_group and table.group is not None else None
    target, classes = table.target, len(table.classes)
    models, fusion = _fit_fused(table.modalities, target, classes, group, seed)
    steps: dict[str, list[ModalityModel]] = {name: [] for name in series}
    step_fusion, count = [], max((values.shape[1] for values in series.values()), default=0)
    for step in range(count):
        if progress is not None:
            progress("training the steps of the squeeze", step, count)
        now = {name: values[:, min(step, values.shape[1] - 1)] for name, values in series.items()}
        now = {name: one for name, one in now.items() if len(np.unique(target[~absent(one)])) > 1}
        found, pool = _fit_fused(now, target, classes, group, seed)
        step_fusion.append(pool)
        for name, model in found.items():
            steps[name].append(model)
    fused = len(steps) > 1 and all(len(found) == count for found in steps.values())
    return ContentModel(
        labels=table.classes,
        modalities=models,
        fusion=fusion,
        steps={name: tuple(found) for name, found in steps.items() if found},
        step_fusion=tuple(step_fusion) if fused else (),
        step_s=table.step_s,
        settings=table.settings,
        promised=promised or {},
        provenance=provenance or {},
    )


def _fit_fused(
    named: Mapping[str, FloatArray], target: IntArray, classes: int, group: IntArray | None, seed: int
) -> tuple[dict[str, ModalityModel], Pool]:
    """The model of each modality (trials, p), and how they are fused."""
    models = {}
    shape = len(named), len(target)
    logs, known = np.zeros((*shape, classes)), np.zeros(shape, dtype=bool)
    for index, (name, values) in enumerate(named.items()):
        rows = np.flatnonzero(~absent(values))
        scaling = fit_scaling(values[rows])
        scaled = scaling.apply(values[rows])
        directions, variance = loadings(scaled)
        centre = scaled.mean(axis=0)
        apart = None if group is None else group[rows]
        points = (scaled - centre) @ directions
        fitted = fit_expert(points, kept_of(variance), scaled.shape[1], target[rows], classes, apart, seed=seed)
        models[name] = ModalityModel(scaling, centre, directions, fitted.expert)
        logs[index, rows], known[index, rows] = fitted.logs, fitted.known
    usable = known.any(axis=0)
    return models, fit_pool(logs[:, usable], known[:, usable], target[usable])
