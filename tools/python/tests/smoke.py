"""What an installed wheel has to do, with numpy alone: files and licences there, an example evaluated, fitted, reconciled.

    cd EMPTY_FOLDER && python smoke.py [frames plots shop shop-s3]    the extras that are installed
"""

import sys
import warnings
from importlib import metadata, util

import rtec

MODULES = {"frames": ["pandas"], "plots": ["matplotlib"], "shop": ["pandas", "pyarrow", "fsspec", "dask", "distributed"], "shop-s3": ["s3fs"]}

found = metadata.metadata("rtec")
assert found["Version"] == rtec.__version__ and found["License-Expression"] == "MIT OR Apache-2.0", found.as_string()
assert set(found.get_all("Provides-Extra")) == set(MODULES), found.get_all("Provides-Extra")
licences = {path.name for path in metadata.files("rtec") if "licenses" in path.parts}
assert licences == {"LICENSE-MIT", "LICENSE-APACHE", "THIRD-PARTY.txt"}, licences
for extra in sys.argv[1:]:
    missing = [name for name in MODULES[extra] if util.find_spec(name) is None]
    assert not missing, f"the extra {extra} does not bring {missing}"

warnings.simplefilter("ignore", rtec.InputWarning)
rtec.example("mill", "mill")
run = rtec.read_record("mill/records/linear-displacement-y.run.toml")
evaluated = rtec.evaluate(run)
fitted = rtec.fit(["mill/records/drift-dry.run.toml", "mill/records/drift-wet.run.toml"], base="mill/machine.toml")
verdict = rtec.reconcile(run, "mill/machine.toml", "mill/holdout/linear-displacement-y.run.toml")
names = [effect["name"] for effect in verdict.effects]
assert "reversal.y" in names and fitted.document["responses"], (names, fitted)
if "frames" in sys.argv:
    assert len(run.to_pandas()) == len(run["error.y"])
if "plots" in sys.argv:
    assert len(evaluated.plots()) == len(evaluated.pictures) > 0
if "shop" in sys.argv:
    import rtec.shop
print(f"Python {sys.version.split()[0]}, rtec {rtec.__version__} with {' '.join(sys.argv[1:]) or 'numpy alone'}:")
print(f"  A {evaluated.document['A']:.2f} µm; {len(fitted.document['responses'])} responses fitted; {verdict.verdict}: {', '.join(names)}")
