"""What a shop costs: `python figures_shop.py [MACHINES]`. It measures and judges nothing."""

import sys
import tempfile
import time

import shop_data as data
from dask.distributed import Client, LocalCluster

from rtec.shop import Shop, assess


def main() -> None:
    largest = int(sys.argv[1]) if len(sys.argv) > 1 else 80
    print("machines  months  ms of a core per month  s over the shop")
    for count in (largest // 4, largest // 2, largest):
        with tempfile.TemporaryDirectory() as folder:
            shop = Shop(folder)
            data.fill(shop, count)
            start = time.process_time()
            found = assess(shop, today="2026-08-01")
            spent = time.process_time() - start
            own = found.months["seconds"].sum()
            print(f"{count:8}  {len(found.months):6}  {1000 * own / len(found.months):22.1f}  {spent - own:15.2f}")
    with tempfile.TemporaryDirectory() as folder:
        shop = Shop(folder)
        data.fill(shop, largest)
        alone = None
        for workers in (1, 2):
            with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster:
                with Client(cluster) as client:
                    client.run(lambda: __import__("rtec.shop"))
                    start = time.perf_counter()
                    assess(shop, client, today="2026-08-01")
                    took = time.perf_counter() - start
                    alone = alone or took
                    print(f"{workers} workers: {took:.1f} s, {alone / took / workers:.2f} of a worker's speed each")


if __name__ == "__main__":
    main()
