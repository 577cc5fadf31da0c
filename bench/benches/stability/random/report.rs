//! Tables of verdicts and costs.

use std::collections::BTreeMap;

use super::follow::{Outcome, VERDICTS};
use super::{Options, Tried, Verdict};

/// One line on a scene that failed.
pub fn words(tried: &Tried) -> String {
    let Some(outcome) = tried.outcome("accurate") else { return String::new() };
    let verdict = tried.verdict("accurate").map_or("", Verdict::name);
    format!("scene {}: {verdict}; {}", tried.index, seen(outcome))
}

/// What was seen in a run, as multiples of what is allowed.
pub fn seen(outcome: &Outcome) -> String {
    let Outcome { seen, message, cost, .. } = outcome;
    let since = if seen.since.is_finite() { format!(" (from {:.4} s)", seen.since) } else { String::new() };
    let passed = seen.passed.map_or(String::new(), |(body, time)| {
        format!(", body {} of the list went through a static one by {time:.4} s", body.index())
    });
    format!(
        "energy × {:.3e}{since}, gap × {:.3e}, depth × {:.3e} of what is allowed{passed}, {:.3e} m/s, {cost:.0} µs{}",
        seen.energy,
        seen.gap,
        seen.depth,
        seen.speed,
        message.as_ref().map_or(String::new(), |message| format!("; {message}"))
    )
}

/// Prints verdicts of each way, failures for each feature, and costs.
pub fn print(options: &Options, ways: &[&'static str], all: &[Tried]) {
    println!("\n### Random scenes\n\n{} scenes of seed {}, from {}.\n", options.scenes, options.seed, options.first);
    let names: Vec<_> = VERDICTS.iter().map(|verdict| verdict.name()).collect();
    println!("| way | {} |\n|{}", names.join(" | "), "---|".repeat(names.len() + 1));
    for way in ways {
        let count = |verdict: &Verdict| all.iter().filter(|tried| tried.verdict(way) == Some(*verdict)).count();
        let counts: Vec<_> = VERDICTS.iter().map(|verdict| count(verdict).to_string()).collect();
        println!("| {way} | {} |", counts.join(" | "));
    }
    features(ways, all);
    costs(ways, all);
}

/// Share of scenes that failed, with and without each feature.
fn features(ways: &[&'static str], all: &[Tried]) {
    let mut table: BTreeMap<&str, Vec<&Tried>> = BTreeMap::new();
    for tried in all {
        tried.scene.features.iter().for_each(|feature| table.entry(feature).or_default().push(tried));
    }
    println!("\n| feature | scenes | {} |\n|{}", ways.join(" | "), "---|".repeat(ways.len() + 2));
    let share = |way: &str, scenes: &[&Tried]| {
        let failed = |least: Verdict| scenes.iter().filter(|tried| tried.verdict(way) >= Some(least)).count();
        let percent = |count: usize| 100.0 * count as f64 / scenes.len().max(1) as f64;
        format!("{:.0} % ({:.1} %)", percent(failed(Verdict::Poor)), percent(failed(Verdict::Energy)))
    };
    let everything: Vec<_> = all.iter().collect();
    for (feature, scenes) in std::iter::once(("all", &everything)).chain(table.iter().map(|(name, list)| (*name, list)))
    {
        let cells: Vec<_> = ways.iter().map(|way| share(way, scenes)).collect();
        println!("| {feature} | {} | {} |", scenes.len(), cells.join(" | "));
    }
    println!("\nPoor or worse, and in brackets energy or worse.");
}

/// CPU time of a sub-step against `legacy` on the same scene.
fn costs(ways: &[&'static str], all: &[Tried]) {
    println!(
        "\n| way | median, µs | p99, µs | largest mean, µs | × legacy: median | p99 | largest | longest sub-step, µs |"
    );
    println!("|{}", "---|".repeat(8));
    for way in ways {
        let pick = |of: &dyn Fn(&Tried, &Outcome) -> Option<f64>| {
            let mut list: Vec<f64> = all.iter().filter_map(|tried| of(tried, tried.outcome(way)?)).collect();
            list.sort_by(f64::total_cmp);
            list
        };
        let cost = pick(&|_, outcome| Some(outcome.cost));
        let ratio = pick(&|tried, outcome| tried.outcome("legacy").map(|legacy| outcome.cost / legacy.cost));
        let worst = pick(&|_, outcome| Some(outcome.worst));
        let at = |list: &[f64], share: f64| match list.len() {
            0 => "–".to_owned(),
            n => format!("{:.1}", list[((n - 1) as f64 * share).round() as usize]),
        };
        println!(
            "| {way} | {} | {} | {} | {} | {} | {} | {} |",
            at(&cost, 0.5),
            at(&cost, 0.99),
            at(&cost, 1.0),
            at(&ratio, 0.5),
            at(&ratio, 0.99),
            at(&ratio, 1.0),
            at(&worst, 1.0)
        );
    }
}
