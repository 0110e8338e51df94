"""Measures the cost of a shop: `python figures_shop.py [MACHINES] [PAIRS]`. It judges nothing.

The growth of the cost is processor time in this process. The speed-up is time on the clock, of one worker and of two in turn. Each
pair runs PAIRS times, and the best of each counts, because other programs on the computer can only make it slower.
"""

import sys
import tempfile
import time

import shop_data as data
from dask.distributed import Client, LocalCluster

from rtec.shop import Shop, assess

TODAY = "2026-08-01"


def growth(largest: int) -> None:
    print("machines  months  ms of a core per month  s over the shop  ms of a core per machine")
    count = min(50, largest)
    while count <= largest:
        with tempfile.TemporaryDirectory() as folder:
            shop = Shop(folder)
            data.fill(shop, count)
            start = time.process_time()
            found = assess(shop, today=TODAY)
            spent = time.process_time() - start
        own = found.months["seconds"].sum()
        months = len(found.months)
        print(
            f"{count:8}  {months:6}  {1000 * own / months:22.1f}  {spent - own:15.2f}  {1000 * spent / count:24.1f}",
            flush=True,
        )
        count *= 2


def workers(count: int, pairs: int) -> None:
    best: dict[int, float] = {}
    core: dict[int, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        shop = Shop(folder)
        data.fill(shop, count)
        for n in [1, 2] * pairs:
            with LocalCluster(n_workers=n, threads_per_worker=1, dashboard_address=None) as cluster:
                with Client(cluster) as client:
                    client.run(lambda: __import__("rtec.shop"))
                    start = time.perf_counter()
                    found = assess(shop, client, today=TODAY)
                    took = time.perf_counter() - start
            if took < best.get(n, took + 1):
                best[n], core[n] = took, found.months["seconds"].sum()
    for n, took in best.items():
        print(
            f"{n} workers, {count} machines: {took:.1f} s at best of {pairs}, {1000 * core[n] / count:.0f} ms of a core per "
            f"machine, {best[1] / took / n:.2f} of a worker's speed each"
        )


if __name__ == "__main__":
    growth(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
    workers(100, int(sys.argv[2]) if len(sys.argv) > 2 else 3)
