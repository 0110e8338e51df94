"""Writes a case's files: NAME.csv, NAME.run.toml, model.toml, truth.json."""
import json
import os

import numpy as np

import shop_records as rec
from shop_cases import CLASSES


def toml_value(value):
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    return repr(float(value))


def write_model(path, effects, name="shop machine"):
    """machine.toml."""
    lines = [f'name = "{name}"']
    for effect in effects:
        lines += ["", "[[effect]]"]
        for key, value in effect.items():
            if key == "um_per_K2" and value == 0.0 or key == "um_per_krpm2" and value == 0.0:
                continue
            lines.append(f"{key} = {toml_value(value)}")
    with open(path, "w") as f:
        f.write("\n".join(lines) + "\n")


def write_run(folder, run, rng):
    """NAME.csv and NAME.run.toml; returns the sidecar's path."""
    table = run.logged_table if hasattr(run, "logged_table") else rec.logged_columns(run, rng)
    head = [f'file = "{run.name}.csv"', f'kind = "{run.kind}"']
    if run.count_um:
        head.append(f"count_um = {run.count_um}")
    if run.kind == "ballbar":
        head += [f"radius_mm = {run.radius}", f"plane = {toml_value(run.plane)}"]
        if run.tell_centre:
            head.append(f"centre_mm = {toml_value(run.centre)}")
    if run.zero:
        head.append(f'zero = "{run.zero}"')
    if run.kind == "positioning" and run.turns:
        head.append(f'turns = "{run.turns}"')
        if run.turns == "overtravel":
            head.append(f"over_mm = {run.over}")
    head += ["", "[columns]"]
    head += [f'{name} = {{ role = "{role}", unit = "{unit}" }}' for name, role, unit, _, _ in table]
    with open(os.path.join(folder, run.name + ".run.toml"), "w") as f:
        f.write("\n".join(head) + "\n")
    with open(os.path.join(folder, run.name + ".csv"), "w") as f:
        f.write(",".join(c[0] for c in table) + "\n")
        texts = [[f"{v:.{decimals}f}" for v in values] for _, _, _, values, decimals in table]
        for row in zip(*texts):
            f.write(",".join(row) + "\n")
    return os.path.join(folder, run.name + ".run.toml")


def write_case(case, folder):
    """All files of a case; returns (training sidecars, hold-out sidecars, model)."""
    os.makedirs(folder, exist_ok=True)
    rng = np.random.default_rng([CLASSES.index(case.kind), case.seed, 99])
    train = [write_run(folder, run, rng) for run in case.train]
    later = [write_run(folder, run, rng) for run in case.holdout]
    model = os.path.join(folder, "model.toml")
    write_model(model, case.model)
    with open(os.path.join(folder, "truth.json"), "w") as f:
        json.dump(case.truth(), f, indent=1, default=float)
    return train, later, model
