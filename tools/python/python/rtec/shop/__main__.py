"""`python -m rtec.shop ship SPOOL URL --machine NAME`, `gather URL`, `assess URL [--cluster ADDRESS] [--out FOLDER]`."""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields
from pathlib import Path

import pandas as pd

import rtec
from rtec.shop import Shop, assess, ship


def main(arguments: list[str] | None = None) -> int:
    """Exit codes: 0 done; 2 bad input; 3 the store is not to be reached."""
    parser = argparse.ArgumentParser("python -m rtec.shop", description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    sends = verbs.add_parser("ship", help="send what waits in a spool folder")
    sends.add_argument("spool", type=Path)
    sends.add_argument("url")
    sends.add_argument("--machine", required=True)
    takes = verbs.add_parser("gather", help="take what was sent among the records")
    takes.add_argument("url")
    judges = verbs.add_parser("assess", help="judge every machine, and look over the shop")
    judges.add_argument("url")
    judges.add_argument("--cluster", help="a scheduler's address, as tcp://host:8786; in this process where left out")
    judges.add_argument("--out", type=Path, help="folder for the tables, as CSV")
    asked = parser.parse_args(arguments)
    try:
        shop = Shop(asked.url)
        if asked.verb == "ship":
            print(*ship(asked.spool, shop, asked.machine), sep="\n")
        elif asked.verb == "gather":
            for key, why in shop.gather():
                print(f"warning: {key}: {why}", file=sys.stderr)
        else:
            found = assess(shop, asked.cluster)
            for name in ("machines", "shared", "drifting", "expiring", "unreadable"):
                with pd.option_context("display.width", 160, "display.max_columns", None):
                    print(f"{name}\n{getattr(found, name).to_string()}\n")
            if asked.out:
                asked.out.mkdir(parents=True, exist_ok=True)
                for field in fields(found):
                    getattr(found, field.name).to_csv(asked.out / f"{field.name}.csv", index=False)
    except (rtec.InputError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"error: {asked.url}: {error}; what was not sent waits", file=sys.stderr)
        return 3
    return 0


if __name__ == "__main__":
    sys.exit(main())
