//! Pieces no longer than the tolerance: joined first, then cleaned.
//!
//! Cleaning leaves out vertices, but no part of the path between them.

use super::{CleaningSummary, NeighbourGrid, SegmentFromEntity};
use crate::contour::{FeatureKind, Segment};
use crate::geometric_fit::Zx;

/// Largest distance of two ends that are one, as a share of the shorter piece.
const REACH: f64 = 1.0 / 3.0;

/// Largest distance of two ends of short pieces that are one, mm.
pub(super) fn reach_mm(first_mm: f64, second_mm: f64) -> f64 {
    first_mm.min(second_mm) * REACH
}

/// Joins short pieces end to end, and drops vertices that are too close.
/// The joined line keeps its place and length. It is left out if it is no longer than the tolerance as a
/// whole.
pub(super) fn joined(
    short: &[SegmentFromEntity],
    tolerance_mm: f64,
    cleaned: &mut CleaningSummary,
) -> Vec<SegmentFromEntity> {
    let ends: Vec<Zx> = short.iter().flat_map(SegmentFromEntity::ends).collect();
    let lengths: Vec<f64> = short.iter().map(|p| p.segment.length_mm()).collect();
    let longest = lengths.iter().copied().fold(0.0, f64::max);
    let places = NeighbourGrid::of(ends.iter().copied(), longest * REACH);
    let mut used = vec![false; short.len()];
    let mut out = Vec::new();
    for first in 0..short.len() {
        if std::mem::replace(&mut used[first], true) {
            continue;
        }
        // Collects each vertex with the piece that leads to it, first from one end, then from the other.
        let mut walk = |mut end: usize| {
            let mut path = vec![(ends[end], end / 2)];
            loop {
                let off = |k: &usize| (ends[*k] - ends[end]).norm();
                let joins =
                    |k: &usize| !used[*k / 2] && off(k) <= reach_mm(lengths[*k / 2], lengths[end / 2]);
                let near = places.around(ends[end]).filter(joins);
                let Some(next) = near.min_by(|a, b| off(a).total_cmp(&off(b)).then(a.cmp(b))) else { break };
                used[next / 2] = true;
                end = next ^ 1;
                path.push((ends[end], end / 2));
            }
            path
        };
        let (forward, mut path) = (walk(2 * first + 1), walk(2 * first));
        path.reverse();
        path.extend(forward);
        out.extend(thinned(&path, short, tolerance_mm, cleaned));
    }
    out
}

/// The lines along a path, its vertices more than the tolerance apart.
fn thinned(
    path: &[(Zx, usize)],
    short: &[SegmentFromEntity],
    tolerance_mm: f64,
    cleaned: &mut CleaningSummary,
) -> Vec<SegmentFromEntity> {
    let near = |a: Zx, b: Zx| (a - b).norm() <= tolerance_mm;
    let (first, last) = (path[0], path[path.len() - 1]);
    let mut kept = vec![first];
    for vertex in &path[1..path.len() - 1] {
        if !near(kept[kept.len() - 1].0, vertex.0) {
            kept.push(*vertex);
        }
    }
    // The end meets a neighbour, so vertices too close before it are dropped.
    while kept.len() > 1 && near(kept[kept.len() - 1].0, last.0) {
        kept.pop();
    }
    if near(kept[kept.len() - 1].0, last.0) {
        cleaned.specks += path.len() - 1;
        let piece = &short[first.1];
        cleaned.speck.get_or_insert_with(|| (piece.line, piece.entity.clone()));
        return Vec::new();
    }
    kept.push(last);
    cleaned.vertices += path.len() - kept.len();
    let line = |pair: &[(Zx, usize)]| SegmentFromEntity {
        segment: Segment::Line { a: pair[0].0, b: pair[1].0 },
        ..short[pair[1].1].clone()
    };
    kept.windows(2).map(line).collect()
}

/// Closes the joints of a chain by moving lines that may be moved.
/// A line along the axis or square to it keeps its place, and so does a curve.
pub(super) fn close_joints(chain: &mut [(Segment, String)], closed: bool) {
    let n = chain.len();
    for i in 0..if closed { n } else { n.saturating_sub(1) } {
        let next = (i + 1) % n;
        let (end, start) = (chain[i].0.at(1.0), chain[next].0.at(0.0));
        let gives_way = |k: usize| {
            n > 1 && end != start && matches!(FeatureKind::of(&chain[k].0), FeatureKind::Taper { .. })
        };
        let (of_next, of_this) = (gives_way(next), gives_way(i));
        if let (true, Segment::Line { a, .. }) = (of_next, &mut chain[next].0) {
            *a = end;
        } else if let (true, Segment::Line { b, .. }) = (of_this, &mut chain[i].0) {
            *b = start;
        }
    }
}
