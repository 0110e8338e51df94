"""A shop of many machines: records and models in one store, judged by an existing cluster.

The store is a folder or an object store, whatever fsspec reaches by its URL::

    inbox/MACHINE/DIGEST/NAME.run.toml            as `rtecctl ship` and :func:`ship` send them
    records/machine=MACHINE/month=YYYY-MM/…       Parquet, one schema (:data:`SCHEMA`), one reading per row
    models/MACHINE/machine.toml                   each machine's model
    machines.toml                                 what the machines have in common: a table for each, as `hall = "south"`

:func:`assess` evaluates and reconciles each month of each machine, one task of Dask each, and looks over the shop: causes that many
machines share, machines that left their history, models near their end.
"""

from rtec._errors import needs

try:
    from rtec.shop._across import drifting, shared
    from rtec.shop._assess import Assessment, assess
    from rtec.shop._store import SCHEMA, Shop, ship
except ModuleNotFoundError as missing:
    raise needs(missing.name or "a package", "shop") from None

__all__ = ["SCHEMA", "Assessment", "Shop", "assess", "drifting", "shared", "ship"]
