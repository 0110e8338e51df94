#!/usr/bin/env python3
"""Every mutant that cargo-mutants lists, from one build for each crate.

cargo-mutants builds a crate and its tests anew for every mutant, which for two thousand of them takes days. Here all mutants of a crate
are compiled in at once, each behind a switch that an environment variable sets; a first run of every test notes which mutants it
comes by, and a mutant is judged by those tests alone, the quickest first, until one fails. What no switch can be made of (a field
left out, an `impl` returned, what is worked out beforehand) is built alone, and judged by all tests, where `--left` asks for it.

    tests/mutants.py [-j N] [--most S] [--left] [--out FOLDER] [FILE...]     of these files; without any, of all that .cargo/mutants.toml names
    tests/mutants.py --table [--out FOLDER]                         what the last runs came to, a row for each file

What was caught once is not asked again: a run after new tests judges the survivors. With `--most S` tests that take more than S seconds of
processor are not asked at all, for a first look.

Needs: cargo-mutants, and the Python packages tree-sitter and tree-sitter-rust.
"""

import argparse
import collections
import concurrent.futures
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RECORD = 2**32 - 1

# The switch. A mutant is met where its number is asked for.
SWITCH = """
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
static ON: AtomicU32 = AtomicU32::new(0);
static MET: [AtomicBool; NUMBER] = [const { AtomicBool::new(false) }; NUMBER];
#[inline]
pub(crate) fn on(n: u32) -> bool {
    let on = ON.load(Relaxed);
    if on == u32::MAX { MET[n as usize].store(true, Relaxed); }
    on == n
}
unsafe extern "C" { fn atexit(end: extern "C" fn()) -> i32; }
extern "C" fn end() {
    use std::io::Write;
    let met: Vec<_> = (0..NUMBER).filter(|&n| MET[n].load(Relaxed)).map(|n| n.to_string()).collect();
    let Some(path) = std::env::var_os("MUTANTS_MET") else { return };
    if let Ok(mut f) = std::fs::File::options().append(true).create(true).open(path) { let _ = writeln!(f, "{}", met.join(" ")); }
}
extern "C" fn begin() {
    let Some(n) = std::env::var("MUTANT").ok().and_then(|n| n.parse().ok()) else { return };
    ON.store(n, Relaxed);
    if n == u32::MAX { unsafe { atexit(end) }; }
}
#[used]
#[unsafe(link_section = ".init_array")]
static BEGIN: extern "C" fn() = begin;
"""


class Build(Exception):
    """What the compiler has against a tree that is not a mutant's."""


def listed(files, *options):
    """What cargo-mutants would judge, in these files or in all."""
    command = ["cargo", "mutants", "--list", "--json", *options]
    out = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [m for m in json.loads(out) if not files or m["file"] in files]


def explained():
    """All of them, also those that the configuration leaves out by name, with reasons."""
    text = (ROOT / ".cargo/mutants.toml").read_text()
    bare = re.sub(r"(?ms)^exclude_re = \[.*?^\]\n", "", text)
    config = ROOT / "target/mutants-all.toml"
    config.parent.mkdir(exist_ok=True)
    config.write_text(bare)
    return listed([], "--config", str(config))


class File:
    """One source file with its mutants switched in."""

    def __init__(self, path, mutants, parser):
        self.path, self.mutants = path, mutants
        self.source = (ROOT / path).read_bytes()
        self.tree = parser.parse(self.source)
        self.starts = [0]
        for line in self.source.split(b"\n"):
            self.starts.append(self.starts[-1] + len(line) + 1)

    def at(self, place):
        """Byte of a line and a column, both from one, the column in characters."""
        start = self.starts[place["line"] - 1]
        end = self.starts[place["line"]]
        return start + len(self.source[start:end].decode()[: place["column"] - 1].encode())

    def node(self, start, kinds, operator=None):
        n = self.tree.root_node.descendant_for_byte_range(start, start + 1)
        while n is not None:
            if n.type in kinds and (operator is None or self.operator(n).start_byte == start):
                if operator is not None or n.start_byte == start:
                    return n
            n = n.parent
        return None

    @staticmethod
    def operator(n):
        return n.child_by_field_name("operator") or n.children[1]

    def switched(self, dropped, pinned):
        """The text; and for each mutant that no switch can be made of, why."""
        wraps, inserts, consts, left = collections.defaultdict(list), collections.defaultdict(list), set(), {}
        # What asks for a switch cannot be worked out beforehand, nor what calls it.
        todo = [self.tree.root_node]
        while todo:
            n = todo.pop()
            todo += n.children
            if n.type == "function_item" and self.text(n.child_by_field_name("name")) not in pinned:
                consts.update(k.start_byte for c in n.children if c.type == "function_modifiers" for k in c.children if k.type == "const")
        for m in self.mutants:
            if m["id"] in dropped:
                continue
            if (m["function"] or {}).get("function_name", "").split("::")[-1] in pinned or m["id"] in pinned:
                left[m["id"]] = "worked out beforehand"
                continue
            start, end, genre = self.at(m["span"]["start"]), self.at(m["span"]["end"]), m["genre"]
            if genre == "BinaryOperator":
                n = self.node(start, ("binary_expression", "compound_assignment_expr"), operator=True)
                if n is None:
                    left[m["id"]] = "in a chain of let"
                    continue
                l, r = n.child_by_field_name("left"), n.child_by_field_name("right")
                before, after = self.text(l), self.text(r)
                if l.type == "type_cast_expression":
                    before = "(" + before + ")"
                wraps[n.id].append((m["id"], f"{before} {m['replacement']} {after}"))
            elif genre == "UnaryOperator":
                n = self.node(start, ("unary_expression",))
                if n is None:
                    left[m["id"]] = "not found"
                    continue
                wraps[n.id].append((m["id"], self.text(n.children[1])))
            elif genre == "FnValue":
                if "impl " in m["function"]["return_type"]:
                    left[m["id"]] = "returns an impl"
                    continue
                inserts[start].append((m["id"], m["replacement"]))
            elif genre in ("MatchArm", "MatchArmGuard"):
                n = self.tree.root_node.descendant_for_byte_range(start, start + 1)
                while n.type != "match_arm":
                    n = n.parent
                pattern = n.child_by_field_name("pattern")
                condition = pattern.child_by_field_name("condition")
                if condition is not None and "let" in condition.type:
                    left[m["id"]] = "a guard with let"
                    continue
                if genre == "MatchArm" and condition is None:
                    inserts[pattern.end_byte].append((m["id"], None))
                else:
                    wraps[condition.id].append((m["id"], m["replacement"] or "false"))
            else:
                left[m["id"]] = "a field left out"
                continue
        return self.emit(self.tree.root_node, wraps, inserts, consts), left

    def text(self, n):
        return self.source[n.start_byte : n.end_byte].decode()

    def emit(self, node, wraps, inserts, consts):
        parts, at = [], node.start_byte

        def plain(until):
            nonlocal at
            while at < until:
                cut = min((p for p in inserts if at <= p < until and p not in done), default=until)
                parts.append(self.source[at:cut].decode())
                at = cut
                if cut < until:
                    put(cut)

        def put(p):
            done.add(p)
            for m, value in inserts[p]:
                if value is None:
                    parts.append(f" /*{m}<*/if !crate::mutant::on({m})/*>{m}*/")
                else:
                    parts.append(f"if crate::mutant::on({m}) {{ return /*{m}<*/{value}/*>{m}*/; }} ")

        done = self.done
        for c in node.children:
            if c.child_count or c.id in wraps:
                plain(c.start_byte)
                if c.start_byte in inserts and c.start_byte not in done:
                    put(c.start_byte)
                parts.append(self.emit(c, wraps, inserts, consts))
                at = c.end_byte
                if at in inserts and at not in done and inserts[at][0][1] is None:
                    put(at)
            elif c.start_byte in consts and c.type == "const":
                plain(c.start_byte)
                at = c.end_byte
        plain(node.end_byte)
        text = "".join(parts)
        if node.id in wraps:
            chain = "".join(f"if crate::mutant::on({m}) {{ /*{m}<*/{alt}/*>{m}*/ }} else " for m, alt in wraps[node.id])
            text = f"({chain}{{ {text} }})"
        return text

    def write(self, tree, dropped, pinned):
        self.done = set()
        text, left = self.switched(dropped, pinned)
        put(tree / self.path, text)
        return left


def put(path, text):
    """Cargo builds anew what is newer, whether it has changed or not."""
    if not path.exists() or path.read_text() != text:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def copy_tree(tree, switched):
    tree.mkdir(parents=True, exist_ok=True)
    names = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\n")
    kept = {n for n in names if n}
    for old in tree.rglob("*"):
        if old.is_file() and str(old.relative_to(tree)) not in kept | switched:
            old.unlink()
    for name in kept - switched:
        new, old = tree / name, ROOT / name
        if not old.is_file():
            continue
        new.parent.mkdir(parents=True, exist_ok=True)
        if not new.exists() or new.read_bytes() != old.read_bytes():
            shutil.copy(old, new)
    shared = tree.parent / "shared"
    if (ROOT.parent / "shared").exists() and not shared.exists():
        shared.symlink_to(ROOT.parent / "shared")


def cargo(tree, out, package):
    env = dict(os.environ, CARGO_TARGET_DIR=str(out / "target"), CARGO_INCREMENTAL="0", RUSTFLAGS="--cap-lints allow")
    command = ["cargo", "test", "-p", package, "--lib", "--tests", "--no-run", "--message-format=json"]
    run = subprocess.run(command, cwd=tree, env=env, capture_output=True, text=True)
    errors, programs = [], []
    for line in run.stdout.splitlines():
        m = json.loads(line)
        if m.get("reason") == "compiler-message" and m["message"]["level"] == "error":
            errors.append(m["message"])
        elif m.get("reason") == "compiler-artifact" and m.get("executable") and m["profile"]["test"]:
            programs.append(m["executable"])
    if run.returncode and not errors:
        raise Build(run.stderr[-3000:])
    return errors, sorted(set(programs))


def blamed(tree, errors):
    """The mutants that errors lie in, or round; and functions and mutants that have to be worked out beforehand."""
    guilty, pinned = set(), set()
    ranges = {}
    for e in errors:
        if e.get("code") and e["code"]["code"] == "E0015":
            span = next(s for s in e["spans"] if s["is_primary"])
            text = (tree / span["file_name"]).read_bytes()[span["byte_start"] : span["byte_end"]]
            switch = re.match(rb"crate::mutant::on\((\d+)\)", text)
            name = re.search(r"`([^`]*)`", e["message"])[1].split("::")[-1]
            pinned.add(int(switch[1]) if switch else name)
            continue
        places = e["spans"] + [s for c in e["children"] for s in c["spans"]]
        hit = set()
        for span in sorted(places, key=lambda s: not s["is_primary"]):
            path = tree / span["file_name"]
            if not path.exists():
                continue
            if path not in ranges:
                data = path.read_bytes()
                found = {}
                for m in re.finditer(rb"/\*(\d+)<\*/", data):
                    close = data.index(b"/*>%s*/" % m[1], m.end())
                    found[int(m[1])] = (m.start(), close + 8)
                ranges[path] = (found, data)
            found, data = ranges[path]
            hit = {n for n, (a, b) in found.items() if a <= span["byte_start"] and span["byte_end"] <= b + 8}
            if not hit:
                # An `if` whose branches differ: the mutants whose switches lie within.
                hit = {n for n, (a, b) in found.items() if span["byte_start"] <= a and b <= span["byte_end"] + 8} if span["byte_end"] - span["byte_start"] < 4000 else set()
            if e.get("code") and e["code"]["code"] == "E0004" and span["is_primary"]:
                # No arm is left for something: any of the match's own that is left out.
                data = ranges[path][1]
                depth, end = 0, data.index(b"{", span["byte_end"])
                for end in range(end, len(data)):
                    depth += {123: 1, 125: -1}.get(data[end], 0)
                    if depth == 0:
                        break
                hit = {int(n) for n in re.findall(rb"/\*(\d+)<\*/if !crate", data[span["byte_end"]:end])}
            if hit:
                break
        guilty |= hit
    return guilty, pinned


def limited(seconds):
    def limit():
        os.setpgrp()
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        soft = 12 << 30
        resource.setrlimit(resource.RLIMIT_AS, (soft, soft))

    return limit


def run_test(tree, package_dir, program, test, mutant, cpu_s, wall_s, met=None):
    """Whether it passes; what it took of the processor, s."""
    env = dict(os.environ, MUTANT=str(mutant), RUST_BACKTRACE="0", PROPTEST_DISABLE_FAILURE_PERSISTENCE="1", PROPTEST_MAX_SHRINK_ITERS="0",
               CARGO_MANIFEST_DIR=str(package_dir))
    if met:
        env["MUTANTS_MET"] = str(met)
    p = subprocess.Popen([program, "--exact", test, "--test-threads", "1"], cwd=package_dir, env=env, stdout=subprocess.DEVNULL,
                         stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL, preexec_fn=limited(cpu_s))
    until = time.monotonic() + wall_s
    while True:
        pid, status, usage = os.wait4(p.pid, os.WNOHANG)
        if pid:
            p.returncode = os.waitstatus_to_exitcode(status)
            break
        if time.monotonic() > until:
            os.killpg(p.pid, signal.SIGKILL)
            _, status, usage = os.wait4(p.pid, 0)
            p.returncode = -9
            break
        time.sleep(0.003)
    return p.returncode, usage.ru_utime + usage.ru_stime


def judge(out, package, mutants, parser, jobs, most, alone):
    tree = out / "tree"
    folder = tree / Path(mutants[0]["file"]).parent.parent
    lib, module = folder / "src/lib.rs", folder / "src/mutant.rs"
    copy_tree(tree, {m["file"] for m in mutants} | {str(f.relative_to(tree)) for f in (lib, module)})
    for n, m in enumerate(mutants, 1):
        m["id"] = n
    by_file = collections.defaultdict(list)
    for m in mutants:
        by_file[m["file"]].append(m)
    files = [File(path, of, parser) for path, of in by_file.items()]
    switch = SWITCH.replace("NUMBER", str(len(mutants) + 1))
    put(module, switch)
    put(lib, (ROOT / lib.relative_to(tree)).read_text().replace("#![forbid(unsafe_code)]", "") + "\n#[allow(warnings)]\nmod mutant;\n")
    known = out / f"{package}.unviable"
    names, pinned = map(set, json.loads(known.read_text())) if known.exists() else (set(), set())
    dropped, left = {m["id"] for m in mutants if m["name"] in names}, {}
    pinned = {next((m["id"] for m in mutants if m["name"] == p), p) for p in pinned}
    for _ in range(30):
        left = {}
        for f in files:
            left.update(f.write(tree, dropped, pinned))
        errors, programs = cargo(tree, out, package)
        if not errors:
            break
        guilty, beforehand = blamed(tree, errors)
        if not guilty and beforehand <= pinned:
            raise Build("\n".join(e["rendered"] for e in errors[:5]))
        print(f"{package}: {len(guilty)} mutants do not compile", flush=True)
        dropped |= guilty
        pinned |= beforehand
    names = {m["id"]: m["name"] for m in mutants}
    known.write_text(json.dumps([[names[n] for n in dropped], [names.get(p, p) for p in pinned]]))
    # All tests once, for what they come by; again only where a program has changed. One that takes longer than is asked for is not.
    tests, lists = [], []
    noted = out / f"{package}.tests"
    old = json.loads(noted.read_text()) if noted.exists() else {}
    stamp = {p: os.stat(p).st_mtime for p in programs}
    for program in programs:
        if old.get(program, {}).get("stamp") == stamp[program]:
            tests += [dict(t, met=set(t["met"])) for t in old[program]["tests"]]
            continue
        listing = subprocess.run([program, "--list", "--format", "terse"], cwd=folder, capture_output=True, text=True).stdout
        for name in re.findall(r"(?m)^(.*): test$", listing):
            lists.append((program, name))

    def meets(test):
        program, name = test
        met_file = out / f"met-{Path(program).name}-{name.replace(':', '-')}"
        met_file.unlink(missing_ok=True)
        code, cpu = run_test(tree, folder, program, name, RECORD, int(min(600, most)) + 1, 1800, met_file)
        met = {int(n) for n in met_file.read_text().split()} if met_file.exists() else set()
        met_file.unlink(missing_ok=True)
        if code in (-24, -9) and most < 600:
            return {"program": program, "name": name, "cpu": 600, "met": {m["id"] for m in mutants}}
        if code:
            print(f"without a mutant {name} fails, and is left out", flush=True)
            return None
        return {"program": program, "name": name, "cpu": cpu, "met": met}

    pool = concurrent.futures.ThreadPoolExecutor(jobs)
    tests += [t for t in pool.map(meets, lists) if t]

    def stamped():
        """What is known of the tests of these programs, for another run."""
        rows = {p: [dict(t, met=sorted(t["met"])) for t in tests if t["program"] == p] for p in programs}
        noted.write_text(json.dumps({p: {"stamp": os.stat(p).st_mtime, "tests": rows[p]} for p in programs}))

    stamped()
    print(f"{package}: {len(tests)} tests, {sum(t['cpu'] for t in tests):.1f} s of processor", flush=True)
    kills = collections.Counter()
    log = out / f"{package}.results"
    before = dict(json.loads(line) for line in log.read_text().splitlines()) if log.exists() else {}

    def one(m):
        known = before.get(m["name"])
        if known and known[0] == "caught" and known[1].split(" ")[0] in {t["name"] for t in tests}:
            return known
        if known and known[0] == "unviable" and m["id"] in left:
            return known
        verdict = judged(m)
        with log.open("a") as f:
            f.write(json.dumps([m["name"], verdict]) + "\n")
        return verdict

    def build_alone(m):
        """The mutant as cargo-mutants would build it; whether it compiles."""
        f = next(f for f in files if f.path == m["file"])
        start, end = (f.at(m["span"][k]) for k in ("start", "end"))
        put(tree / f.path, (f.source[:start] + m["replacement"].encode() + f.source[end:]).decode())
        errors, _ = cargo(tree, out, package)
        return not errors

    def judged(m):
        if m["id"] in dropped or left.get(m["id"]) == "in a chain of let":
            return "unviable", ""
        if m["id"] in left:
            if not alone:
                return "left", left[m["id"]]
            if not build_alone(m):
                return "unviable", ""
            mine = list(tests)
        else:
            mine = [t for t in tests if m["id"] in t["met"]]
        # The quickest first, those that have found more before those that have found less.
        mine.sort(key=lambda t: (t["cpu"] + 0.01) / (1 + kills[t["name"]] ** 0.5))
        for t in mine:
            if t["cpu"] > most:
                continue
            code, _ = run_test(tree, folder, t["program"], t["name"], m["id"], int(10 * t["cpu"]) + 1, 100 * t["cpu"] + 60)
            if code:
                kills[t["name"]] += 1
                return "caught", t["name"] + (" (endless)" if code in (-9, -24) else "")
        slow = sum(t["cpu"] > most for t in mine)
        return "missed", f"{len(mine)} tests come by" + (f", {slow} of them not asked" if slow else "")

    results = out / "results"
    results.mkdir(exist_ok=True)
    for path, of in by_file.items():
        began = time.monotonic()
        rows = []
        switchable = [m for m in of if m["id"] not in left or not alone]
        verdicts = dict(zip((m["id"] for m in switchable), pool.map(one, switchable)))
        # One after the other: each is a build, the programs of which take the place of the others'.
        by_itself = [m for m in of if m["id"] not in verdicts]
        verdicts.update((m["id"], one(m)) for m in by_itself)
        for m in of:
            what, why = verdicts[m["id"]]
            rows.append({"name": m["name"], "what": what, "why": why})
            if what in ("missed", "left"):
                print(f"{what}: {m['name']}  ({why})", flush=True)
        if by_itself:
            next(f for f in files if f.path == path).write(tree, dropped, pinned)
            cargo(tree, out, package)
            stamped()
        (results / (path.replace("/", "_") + ".json")).write_text(json.dumps({"file": path, "rows": rows}, indent=1))
        n = collections.Counter(r["what"] for r in rows)
        print(f"{path}: {dict(n)}, {time.monotonic() - began:.0f} s", flush=True)


def table(out):
    total = collections.Counter()
    left_in = {m["name"] for m in listed([])}
    named = collections.Counter(m["file"] for m in explained() if m["name"] not in left_in)
    print("| file | viable | caught | explained | survivors |\n|---|---|---|---|---|")
    for path in sorted((out / "results").glob("*.json")):
        data = json.loads(path.read_text())
        n = collections.Counter(r["what"] for r in data["rows"] if r["name"] in left_in)
        row = {"caught": n["caught"], "missed": n["missed"], "left": n["left"], "explained": named[data["file"]]}
        row["viable"] = row["caught"] + row["missed"] + row["explained"]
        total.update(row)
        print(f"| `{data['file']}` | {row['viable']} | {row['caught']} | {row['explained']} | {row['missed']} |")
    print(f"| all | {total['viable']} | {total['caught']} | {total['explained']} | {total['missed']} |")
    print(f"{total['left']} left to cargo-mutants")


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("-j", type=int, default=1, help="tests at once")
    p.add_argument("--most", type=float, default=float("inf"), help="ask no test that takes longer, s of processor")
    p.add_argument("--left", action="store_true", help="build those alone that no switch can be made of")
    p.add_argument("--out", type=Path, default=ROOT / "target/mutants-all")
    p.add_argument("--table", action="store_true")
    p.add_argument("files", nargs="*")
    a = p.parse_args()
    out = a.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    if a.table:
        return table(out)
    import tree_sitter
    import tree_sitter_rust

    parser = tree_sitter.Parser(tree_sitter.Language(tree_sitter_rust.language()))
    by_package = collections.defaultdict(list)
    for m in listed(a.files):
        by_package[m["package"]].append(m)
    for package, mutants in by_package.items():
        judge(out, package, mutants, parser, a.j, a.most, a.left)
    return 0


if __name__ == "__main__":
    sys.exit(main())
