"""The types of the documents, for type checkers and editors.

The keys are those of ``rtecctl … --json``; the guide's reference describes them.

A key that not every document has is marked ``NotRequired``. ``by`` is the program that wrote the document.
"""

from __future__ import annotations

from typing import Any, Literal, NotRequired, TypedDict

#: A plot as data. ``kind`` is ``chart`` (series over an axis), ``polar`` (deviations from a circle, µm) or ``vectors`` (µm at places in mm).
Picture = dict[str, Any]


class Interval(TypedDict):
    """A parameter with its 95 % interval; ``before`` is the model's value."""

    value: Any
    low: NotRequired[Any]
    high: NotRequired[Any]
    before: NotRequired[Any]


class Suspicion(TypedDict):
    """A mistake that a record shows."""

    record: str
    column: str
    rows: str
    what: str
    text: str


class Effect(TypedDict):
    """An effect that was found or corrected.

    Keys that are not numbers (``sensor``, ``minus``, ``knots_mm``) are beside ``parameters``."""

    name: str
    parameters: dict[str, Interval]
    p_value: NotRequired[float | None]
    log_evidence: NotRequired[float]
    alternatives: NotRequired[list[dict[str, Any]]]
    sensor: NotRequired[str]
    minus: NotRequired[str]
    reference_degC: NotRequired[float]
    knots_mm: NotRequired[list[float]]


class Place(TypedDict):
    """Where measured and simulated disagree."""

    response: str
    against: str
    statistic: float
    p_value: float
    q_value: float
    period: Any
    near_turns: bool
    profile: list[Any]


class Change(TypedDict):
    """RMS of measured minus simulated."""

    before: float
    after: float


class Gap(TypedDict):
    """How far the gap between measured and simulated shrank."""

    train: Change
    holdout: Change | None
    holdout_without_suspected: Change | None
    cross_validation: Change | None
    floor: float
    unit: str
    closed: float | None


class VerdictDocument(TypedDict):
    """What a model lacks."""

    format: int
    by: str
    verdict: Literal["named", "nothing_missing", "unknown_effect", "not_separable"]
    where: list[Place]
    effects: list[Effect]
    refined: list[Effect]
    stand_in: dict[str, str] | None
    no_stand_in: str | None
    unexplained: list[dict[str, Any]]
    gap: Gap | list[Gap]
    confirmed: bool | None
    set_up: dict[str, dict[str, Any]]
    suspicions: list[Suspicion]
    left_out: list[str]
    nothing_said_of: list[str]
    derived: list[str]
    advice: str
    tried: list[dict[str, Any]]
    level: float
    seed: int
    noise: dict[str, float]


class WhereDocument(TypedDict):
    """The first stage of a reconciliation."""

    format: int
    by: str
    where: list[Place]
    level: float
    seed: int


class EvaluationDocument(TypedDict, total=False):
    """Figures of a standard, µm unless the name says otherwise. The keys depend on the standard."""

    format: int
    by: str
    suspicions: list[Suspicion]
    warnings: list[str]
    with_every_row: dict[str, Any]
    # ISO 230-2
    test: str
    axis: str
    response: str
    unit: str
    travel_mm: float
    targets: list[dict[str, Any]]
    A: float
    A_up: float | None
    A_down: float | None
    E: float
    E_up: float | None
    E_down: float | None
    R: float
    R_up: float | None
    R_down: float | None
    B: float | None
    B_mean: float | None
    M: float
    uncertainty: dict[str, Any] | None
    # ISO 230-3: one entry per response
    axes: list[dict[str, Any]]
    # ISO 230-4, ballbar
    planes: list[dict[str, Any]]
    plane: str
    radius_mm: float
    radius_um: float
    centre_um: list[float]
    contours: list[dict[str, Any]]
    contributions: list[dict[str, Any]]
    not_separable: dict[str, Any]
    cyclic: dict[str, dict[str, float]]
    form: dict[str, Any]
    interval_95: dict[str, list[float]]
    reversal: dict[str, float]
    spike: dict[str, dict[str, float]]
    rms: float
    scale_mismatch_ppm: float | None
    servo_mismatch_ms: float | None
    squareness_urad: float | None
    unexplained_um: float | None
    scatter_um: float
    D: float
    F_max: float
    F_min: float
    G_b: float
    G_ccw: float
    G_cw: float
    H: float
    # Straightness
    across: str
    symbol: str
    straightness_um: float
    straightness_up_um: float | None
    straightness_down_um: float | None
    slope_urad: float
    slope_standard_error_urad: float
    reversal_um: float | None
    repeatability_um: float | None
    places: list[dict[str, Any]]
    # Repeatability: one entry per axis
    x: dict[str, Any]
    y: dict[str, Any]
    z: dict[str, Any]
    # A plate
    holes: int
    joint: dict[str, Any]
    offset_mm: list[float]
    quadrupole: float
    quadrupole_deg: float
    quadrupole_ppm: float
    remark: str
    residual_um: list[list[float]]
    rms_um: float
    rms_quadrupole_um: float
    rms_um_by_diameter: dict[str, float]
    rotation_deg: float
    rotation_urad: float
    scale: float
    scale_as_aluminium_K: float
    scale_ppm: float
    standard_error: dict[str, Any]


class FitDocument(TypedDict, total=False):
    """A fit.

    A fit by temperatures has one entry of ``responses`` per response; one of named effects has ``effects``, ``rms_um``, ``zeros``."""

    format: int
    by: str
    responses: list[dict[str, Any]]
    effects: list[Effect]
    rms_um: list[Any]
    rms_N: list[Any]
    zeros: list[Any]
    warnings: list[str]
    suspicions: list[Suspicion]


class ChainFitDocument(TypedDict):
    """A chain's fit."""

    format: int
    by: str
    terms: list[dict[str, Any]]
    rms_um: list[Any]
    warnings: list[str]


class ValidationDocument(TypedDict):
    """A model judged on records."""

    format: int
    by: str
    responses: list[dict[str, Any]]
    no_better: list[str]
    suspicions: list[Suspicion]


class TableDocument(TypedDict):
    """A controller's table, and its residuals against the model."""

    format: int
    by: str
    axis: str
    along: str
    from_mm: float
    to_mm: float
    step_mm: float
    points: int
    constant_um: float
    between_um: float
    behind_turn_um: float
    max_up_um: float
    max_down_um: float
    rms_um: float
    temperatures_degC: dict[str, float]
    warnings: list[str]


class Step(TypedDict):
    """One run of a plan."""

    number: int
    record: str
    kind: str
    state: str
    mount: str
    run: str
    columns: list[str]
    evaluate: str
    minutes: float


class DesignsDocument(TypedDict):
    """Designs of insertion side by side."""

    format: int
    by: str
    designs: list[dict[str, Any]]
    motion: dict[str, Any]
    timing: dict[str, Any]


class ReplayDocument(TypedDict):
    """The counts that the controller would have received."""

    format: int
    by: str
    counts_in: int
    counts_out: int
    requested: int
    completed: int
    insertions: int
    illegal_in: int
    illegal_out: int
    min_edge_separation_ns: int | None
    waited_for_gate: int
    overlaps: int
    refused: list[Any]
    faults: list[Any]
    edges: int
    dead_channel: NotRequired[str]


class PartError(TypedDict):
    """The error of one probed point."""

    angle_rad: float
    error_um: float


class PartDocument(TypedDict, total=False):
    """A feature's errors."""

    format: int
    by: str
    feature: str
    points: int
    tip_mm: float
    radius_mm: float
    centre_mm: list[float]
    size_error_um: float
    centre_standard_error_um: list[float]
    size_standard_error_um: float
    plain_centre_mm: list[float]
    plain_radius_mm: float
    plain_size_standard_error_um: float
    robust: dict[str, Any]
    repeats: dict[str, Any]
    sd_before_um: float
    sd_after_um: float
    form_um: float
    rejected: list[int]
    errors: list[PartError]


class BatchStep(TypedDict):
    """A step of a place's errors between two parts."""

    part: str
    um: float
    sd_about_um: float
    p_value: float


class BatchPlace(TypedDict):
    """One place of a feature over a batch. ``interval_um`` is ``None`` where every reading of the batch is 0."""

    feature: str
    angle_rad: NotRequired[float]
    parts: int
    mean_um: float
    sd_um: float
    interval_um: list[float] | None
    p_value: float
    trend_um_per_part: float
    trend_standard_error_um: float
    sd_about_trend_um: float
    trend_p_value: float
    seen_on_machine_um: NotRequired[float]
    step: NotRequired[BatchStep]
    left_out: NotRequired[list[dict[str, Any]]]
    with_every_row: NotRequired[dict[str, float]]
    finding: Literal["nothing", "systematic", "not_observable", "trend", "step"]


class BatchDocument(TypedDict):
    """What ``part post-process`` says of a batch."""

    format: int
    by: str
    places: list[BatchPlace]
    offer_table: list[dict[str, Any]]
    offers: list[str]
    step_um: NotRequired[float]


class HistoryDocument(TypedDict):
    """One machine's figures over time."""

    format: int
    by: str
    machine: str
    figures: list[dict[str, Any]]
    left_out: list[dict[str, str]]
    suspicions: NotRequired[list[Suspicion]]
    changes: NotRequired[list[str]]


class MachineDocument(TypedDict):
    """A machine model."""

    format: int
    by: str
    name: str
    effects: list[dict[str, Any]]
    fits: list[dict[str, Any]]
    chain: Any
