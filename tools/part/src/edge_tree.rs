//! Straight edges in a tree of boxes, to find the nearest edge or those on a ray.

use crate::geometric_fit::Zx;

/// Edges in a leaf of the tree.
const LEAF: usize = 4;

/// Edges in their order, with a binary tree of the boxes around runs of them.
#[derive(Debug, Clone)]
pub(crate) struct EdgeTree {
    edges: Vec<[Zx; 2]>,
    /// Lowest and highest corner of each node.
    /// Node `k` has the children `2 k` and `2 k + 1`; the root is 1.
    boxes: Vec<[Zx; 2]>,
}

/// The empty box.
const NOTHING: [Zx; 2] =
    [Zx::new(f64::INFINITY, f64::INFINITY), Zx::new(f64::NEG_INFINITY, f64::NEG_INFINITY)];

/// The box around two boxes.
pub(crate) fn around([a, b]: [Zx; 2], [c, d]: [Zx; 2]) -> [Zx; 2] {
    [Zx::new(a.z.min(c.z), a.x.min(c.x)), Zx::new(b.z.max(d.z), b.x.max(d.x))]
}

/// Distance from a point to a box, 0 within it.
fn off_box(p: Zx, [low, high]: [Zx; 2]) -> f64 {
    Zx::new((low.z - p.z).max(p.z - high.z).max(0.0), (low.x - p.x).max(p.x - high.x).max(0.0)).norm()
}

/// Foot of a point on an edge.
fn foot(p: Zx, [a, b]: [Zx; 2]) -> Zx {
    #[cfg(test)]
    tests::LOOKS.with(|looks| looks.set(looks.get() + 1));
    let d = b - a;
    let square = d.dot(d);
    let t = if square > 0.0 { ((p - a).dot(d) / square).clamp(0.0, 1.0) } else { 0.0 };
    a + d * t
}

impl EdgeTree {
    pub(crate) fn new(edges: Vec<[Zx; 2]>) -> Self {
        let leaves = edges.len().div_ceil(LEAF).next_power_of_two();
        let mut boxes = vec![NOTHING; 2 * leaves];
        for (run, leaf) in edges.chunks(LEAF).zip(&mut boxes[leaves..]) {
            *leaf = run.iter().fold(NOTHING, |b, [p, q]| around(around(b, [*p, *p]), [*q, *q]));
        }
        for k in (1..leaves).rev() {
            boxes[k] = around(boxes[2 * k], boxes[2 * k + 1]);
        }
        Self { edges, boxes }
    }

    /// The start of an edge.
    pub(crate) fn start(&self, n: usize) -> Zx {
        self.edges[n][0]
    }

    /// The edges of a leaf, with their indices.
    /// `None` for a node above the leaves.
    fn leaf(&self, node: usize) -> Option<impl Iterator<Item = (usize, [Zx; 2])>> {
        let first = node.checked_sub(self.boxes.len() / 2)? * LEAF;
        let last = (first + LEAF).min(self.edges.len());
        Some((first..last).map(|n| (n, self.edges[n])))
    }

    /// Distance to the nearest edge, its index, and the nearest point on it.
    /// Among equal edges it is the first; `None` if none is nearer than `within`.
    pub(crate) fn nearest(&self, p: Zx, within: f64) -> Option<(f64, usize, Zx)> {
        let (mut best, mut open) = (None::<(f64, usize, Zx)>, vec![1]);
        while let Some(node) = open.pop() {
            if off_box(p, self.boxes[node]) > best.map_or(within, |(least, ..)| least) {
                continue;
            }
            let Some(leaf) = self.leaf(node) else {
                let [near, far] = [2 * node, 2 * node + 1];
                let turned = off_box(p, self.boxes[far]) < off_box(p, self.boxes[near]);
                open.extend(if turned { [near, far] } else { [far, near] });
                continue;
            };
            for (n, edge) in leaf {
                let at = foot(p, edge);
                let off = (p - at).norm();
                let is_nearer =
                    |(least, first, _): (f64, usize, Zx)| off.total_cmp(&least).then(n.cmp(&first)).is_lt();
                if best.map_or(off < within, is_nearer) {
                    best = Some((off, n, at));
                }
            }
        }
        best
    }

    /// The number of edges that a ray from a point towards larger Z crosses.
    pub(crate) fn crossings(&self, p: Zx) -> usize {
        let crosses = |[a, b]: [Zx; 2]| {
            (a.x > p.x) != (b.x > p.x) && p.z < a.z + (p.x - a.x) / (b.x - a.x) * (b.z - a.z)
        };
        let (mut crossed, mut open) = (0, vec![1]);
        while let Some(node) = open.pop() {
            let [low, high] = self.boxes[node];
            if p.x < low.x || p.x > high.x || p.z > high.z {
                continue;
            }
            match self.leaf(node) {
                Some(leaf) => crossed += leaf.filter(|(_, edge)| crosses(*edge)).count(),
                None => open.extend([2 * node, 2 * node + 1]),
            }
        }
        crossed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    thread_local! {
        /// Number of edges that were examined.
        pub(super) static LOOKS: Cell<u64> = const { Cell::new(0) };
    }

    #[test]
    fn looks_at_few_edges_of_many() {
        let corner = |i: u32| Zx::at_angle(f64::from(i) / 40_000.0) * 20.0;
        let edges = EdgeTree::new((0..60_000).map(|i| [corner(i), corner(i + 1)]).collect());
        LOOKS.with(|looks| looks.set(0));
        for k in 0..1000_u32 {
            edges.nearest(Zx::at_angle(f64::from(k) / 700.0) * (20.0 + f64::from(k % 7)), f64::INFINITY);
        }
        let looks = LOOKS.with(Cell::get);
        assert!(looks < 500 * 1000, "{looks}");
    }

    #[test]
    fn finds_what_a_look_at_all_finds() {
        for n in [1_u32, 3, 4, 5, 17, 300] {
            let corner = |i: u32| {
                let turn = f64::from(i) / f64::from(n) * std::f64::consts::TAU;
                Zx::at_angle(turn) * (10.0 + (7.0 * turn).sin())
            };
            let all: Vec<[Zx; 2]> = (0..n).map(|i| [corner(i), corner((i + 1) % n)]).collect();
            let edges = EdgeTree::new(all.clone());
            for k in 0..500_u32 {
                let p = Zx::new(f64::from(k % 25) - 12.0, f64::from(k / 20) - 12.0);
                let by_all = all.iter().enumerate().map(|(i, e)| ((p - foot(p, *e)).norm(), i));
                let least = by_all.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                assert_eq!(edges.nearest(p, f64::INFINITY).map(|(off, i, _)| (off, i)), least, "{n} {p:?}");
                let inside = p.norm() < 10.0 + (7.0 * p.angle_rad()).sin();
                if n == 300 && (p.norm() - 10.0 - (7.0 * p.angle_rad()).sin()).abs() > 0.1 {
                    assert_eq!(edges.crossings(p) % 2 == 1, inside, "{p:?}");
                }
            }
        }
        assert_eq!(EdgeTree::new(Vec::new()).nearest(Zx::new(0.0, 0.0), f64::INFINITY), None);
        assert_eq!(EdgeTree::new(Vec::new()).crossings(Zx::new(0.0, 0.0)), 0);
    }
}
