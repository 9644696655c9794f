//! The complete search: finds positions whenever there are any, or proves that there are none.

mod difference;
mod literal;
mod restart;
mod search;

use super::request::{Request, gcd};
use search::{Search, Separation, Verdict};

/// What came out.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum Answer {
    /// Positions, one for each item.
    Placed(Vec<i64>),
    /// There are none.
    Impossible,
    /// Not decided within the budget.
    Unknown,
}

/// Searches for positions; `proceed` is told now and then how many steps were taken, and says whether to go on.
pub(super) fn solve(request: &Request, proceed: &mut dyn FnMut(u64) -> bool) -> Answer {
    let items = request.items.len() as u64;
    if !proceed(20 * items * items) {
        return Answer::Unknown;
    }
    let Some(separations) = separations(request) else { return Answer::Impossible };
    let always = always(request);
    let Some(mut search) = Search::new(request.items.len() + 1, &always, separations) else {
        return Answer::Impossible;
    };
    match search.run(proceed) {
        Verdict::Found(positions) => {
            Answer::Placed(positions[1..].iter().map(|x| x - positions[0]).collect())
        }
        Verdict::Impossible => Answer::Impossible,
        Verdict::GaveUp => Answer::Unknown,
    }
}

/// How many truth values the search would have, roughly: what it costs.
pub(super) fn size(request: &Request) -> i64 {
    let mut size: i64 = 0;
    for (at, a) in request.items.iter().enumerate() {
        for b in &request.items[..at] {
            size = size.saturating_add((a.period + b.period) / gcd(a.period, b.period));
        }
    }
    size
}

/// What must hold between pairs; `None` if a pair cannot be satisfied at all.
fn separations(request: &Request) -> Option<Vec<Separation>> {
    let items = &request.items;
    let mut separations = Vec::new();
    for i in 0..items.len() {
        for j in 0..i {
            let modulus = gcd(items[i].period, items[j].period);
            if items[i].window + items[j].window > modulus {
                return None;
            }
            let (low, up) = (-items[i].window, items[j].window);
            separations.push(Separation { i: i + 1, j: j + 1, modulus, low, up });
        }
    }
    for link in &request.links {
        let (first, then) = (&items[link.first], &items[link.then]);
        let modulus = first.period.min(then.period);
        let up = first.window;
        // Behind by the window and at most `within` more: the rest of the shorter period is forbidden.
        let low = up + link.within - modulus;
        if low < up - 1 {
            separations.push(Separation { i: link.then + 1, j: link.first + 1, modulus, low, up });
        }
    }
    Some(separations)
}

/// Bounds of single positions, spacings, and an order among items that cannot be told apart.
fn always(request: &Request) -> Vec<(usize, usize, i64)> {
    let items = &request.items;
    let mut edges = Vec::new();
    for (at, item) in items.iter().enumerate() {
        edges.push((0, at + 1, item.latest));
        edges.push((at + 1, 0, -item.earliest));
        if let Some(spacing) = item.spacing {
            edges.push((spacing.reference + 1, at + 1, spacing.offset + spacing.jitter));
            edges.push((at + 1, spacing.reference + 1, spacing.jitter - spacing.offset));
        }
        let linked = |k: usize| request.links.iter().any(|link| link.first == k || link.then == k);
        let referred = |k: usize| items.iter().any(|i| i.spacing.is_some_and(|s| s.reference == k));
        let plain = |k: usize| !linked(k) && !referred(k) && items[k].spacing.is_none();
        let twin = (0..at).rev().find(|&k| items[k] == *item && plain(k));
        if let Some(twin) = twin.filter(|_| plain(at)) {
            edges.push((at + 1, twin + 1, -item.window));
        }
    }
    edges
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::request::{Item, Link};

    fn item(period: i64, window: i64) -> Item {
        Item { period, window, earliest: 0, latest: period - 1, spacing: None }
    }

    fn solved(items: &[Item], links: &[Link]) -> Answer {
        let request = Request { items: items.to_vec(), links: links.to_vec() };
        let answer = solve(&request, &mut |_| true);
        if let Answer::Placed(positions) = &answer {
            assert!(request.accepts(positions), "{positions:?}");
        }
        answer
    }

    #[test]
    fn a_full_bus_is_filled() {
        // 2/4 + 2/8 + 2/8: nothing is left over.
        let full = [item(4, 2), item(8, 2), item(8, 2)];
        assert!(matches!(solved(&full, &[]), Answer::Placed(_)));
        assert_eq!(solved(&[item(4, 2), item(8, 2), item(8, 2), item(16, 1)], &[]), Answer::Impossible);
    }

    #[test]
    fn periods_need_not_divide_each_other() {
        assert!(matches!(solved(&[item(4, 1), item(6, 1)], &[]), Answer::Placed(_)));
        assert_eq!(solved(&[item(4, 1), item(6, 1), item(10, 1)], &[]), Answer::Impossible);
        assert_eq!(solved(&[item(4, 2), item(6, 1)], &[]), Answer::Impossible);
    }

    #[test]
    fn links_and_bounds_hold() {
        let mut late = item(20, 2);
        late.earliest = 15;
        let link = Link { first: 0, then: 1, within: 3 };
        let Answer::Placed(x) = solved(&[late, item(10, 2)], &[link]) else { panic!("there is a place") };
        assert!((x[1] - x[0] - 2).rem_euclid(10) <= 3);
        let ring = [Link { within: 2, ..link }, Link { first: 1, then: 0, within: 3 }];
        assert_eq!(solved(&[late, item(10, 2)], &ring), Answer::Impossible);
    }

    #[test]
    fn order_must_be_found_among_tight_deadlines() {
        // One machine, release times and deadlines: 0..3, 1..4 and so on leave exactly one order.
        let items: Vec<Item> =
            (0..20).map(|k| Item { earliest: 5 * k, latest: 5 * k + 3, ..item(100, 5) }).rev().collect();
        assert!(matches!(solved(&items, &[]), Answer::Placed(_)));
        let mut clash = items.clone();
        clash[7].latest -= 3;
        clash[7].window += 1;
        clash[8].earliest = clash[8].latest;
        assert_eq!(solved(&clash, &[]), Answer::Impossible);
    }
}
