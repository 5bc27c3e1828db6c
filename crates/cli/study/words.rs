//! A study in words: for the terminal, and for the page.

use gdibl_baker::analyse::study::{BreakEven, CostAt, FAR, Floor, GDIBL, HONEST, Method, PATH, Study};
use gdibl_baker::radiance::blend::BlendRule;

use super::report::Report;

/// A table of every measurement, and what it comes to.
pub fn report(report: &Report) -> String {
    let Report { study, .. } = report;
    let width = study.methods.iter().map(|method| method.name.chars().count()).max().unwrap_or(0);
    let mut lines = vec![format!("{}, {}: {}, {}", report.level, report.light, report.places, report.sh)];
    lines.push(format!("  reference  {}{}", report.reference.about, reference_noise_text(study)));
    lines.push(String::new());
    lines.push(format!(
        "  {:width$} {:>10} {:>12} {:>10} {:>19} {:>9} {:>9} {:>13}",
        "", "directions", "CPU ms/node", "error", "(least to most)", "noise", "stated", "between nodes"
    ));
    for method in &study.methods {
        for point in &method.points {
            let range = format!("({} to {})", number(100.0 * point.error.least), percent(point.error.most));
            lines.push(format!(
                "  {:width$} {:>10} {:>12} {:>10} {range:>19} {:>9} {:>9} {:>13}",
                method.name,
                point.budget,
                number(point.milliseconds_per_node.middle),
                percent(point.error.middle),
                percent(point.noise.middle),
                point.estimated.map_or("unknown".into(), percent),
                point.seen.map_or(String::new(), |seen| percent(seen.p95)),
            ));
        }
    }
    lines.push(String::new());
    lines.extend(verdict(report).into_iter().map(|line| format!("  {line}")));
    lines.join("\n")
}

/// What it comes to, line by line: what to do, how sure that is, what is wrong between nodes, and what each method takes.
pub fn verdict(report: &Report) -> Vec<String> {
    let study = &report.study;
    let mut lines = vec![advice(report)];
    lines.extend(trust(report));
    lines.extend(study.reference_noise.filter(|noise| *noise > 0.5 * study.target).map(|noise| {
        format!(
            "the reference's own noise is {}: an error of {} is hardly told from it; make it with more --reference-samples, or give a \
             better --reference",
            percent(noise),
            round_percent(study.target)
        )
    }));
    lines.extend(between_nodes(report));
    lines.push(format!("CPU time per node at {} noise, and the bias that is left then:", round_percent(study.target)));
    for method in study.methods.iter().filter(|method| !method.is_far || report.all_drawn) {
        let beside = match (method.times_less, method.name.as_str()) {
            (_, PATH) | (None, _) => String::new(),
            (Some(times), _) => format!(", {} {PATH}", times_text(times)),
        };
        let at = method.at_noise.map_or_else(|| never(method).into(), cost_text);
        let luck = if method.erratic { "; known by luck: its noise jumps, rare bright directions decide" } else { "" };
        lines.push(format!("  {}: {at}{beside}; {}{luck}", method.name, floor_text(&method.floor, study.target)));
    }
    let far: Vec<&str> = study.methods.iter().filter(|method| method.is_far).map(|method| &method.name[..]).collect();
    if !far.is_empty() && !report.all_drawn {
        lines.push(format!(
            "more than {FAR} times the best one's time for {} of error: {}; ask for them by --methods to see them drawn",
            round_percent(study.target),
            far.join(", ")
        ));
    }
    lines.extend(capture_lines(study));
    for group in report.left_out.chunk_by(|a, b| a.why == b.why) {
        let methods: Vec<&str> = group.iter().map(|left| &left.method[..]).collect();
        lines.push(format!("left out: {}: {}", methods.join(", "), group[0].why));
    }
    lines
}

/// Why a method's noise does not come to what was asked for.
pub fn never(method: &Method) -> &'static str {
    if method.slope.is_some_and(|slope| slope < 0.0) {
        NOT_WITHIN
    } else {
        "not known, its noise does not fall with more directions"
    }
}

/// Of what takes too long to say how long.
const NOT_WITHIN: &str = "not within 1000 times the longest run";

/// The flags by which `bake` does what a method does; `None`: it cannot.
fn flags(method: &Method, captured: bool) -> Option<String> {
    match method.name.strip_prefix(GDIBL) {
        None if method.name == PATH => Some("--method path".into()),
        Some("") if !captured => Some("--method gdibl".into()),
        Some(" with capture") if captured => Some("--method gdibl".into()),
        Some(rule) if !captured => {
            rule.trim().parse::<BlendRule>().ok().map(|rule| format!("--method gdibl --blend {rule}"))
        }
        _ => None,
    }
}

/// The methods that `bake` has, with their flags.
fn offered(report: &Report) -> impl Iterator<Item = (&Method, String)> {
    report.study.methods.iter().filter_map(|method| Some((method, flags(method, report.captured)?)))
}

/// Which method, with how many directions, and what that takes.
pub fn advice(report: &Report) -> String {
    let study = &report.study;
    let target = round_percent(study.target);
    let known =
        offered(report).filter_map(|(method, flags)| Some((method, flags, method.at_error?, method.total_seconds?)));
    let best = known.min_by(|a, b| a.3.total_cmp(&b.3));
    if let Some((method, flags, at, seconds)) = best {
        let parallel = method.points.last().map_or(1.0, |point| point.wall_seconds.middle / point.cpu_seconds.middle);
        let guess = if at.extrapolated { ", which is outside of what was measured" } else { "" };
        return format!(
            "advice: use {flags} --samples {}: {target} of error at {} nodes in about {} s of CPU, {} s on {} threads{guess}",
            directions(at.directions),
            study.nodes,
            number(seconds),
            number(seconds * parallel),
            report.threads
        );
    }
    let least = offered(report).filter_map(|(method, flags)| Some((method.points.last()?, flags)));
    match least.min_by(|(a, _), (b, _)| a.error.middle.total_cmp(&b.error.middle)) {
        Some((point, flags)) => format!(
            "advice: no method comes to {target} of error; the best that was measured is {flags} --samples {}: {} in {} s of CPU",
            point.budget,
            percent(point.error.middle),
            number(point.cpu_seconds.middle + point.setup_seconds)
        ),
        None => format!("advice: none; no method that gdibl bake has came to {target} of error"),
    }
}

/// A number of directions, rounded up to two digits.
fn directions(wanted: f64) -> u64 {
    let step = 10f64.powi((wanted.max(1.0).log10().floor() as i32 - 1).max(0));
    ((wanted / step).ceil() * step) as u64
}

/// Whether what bakes say of their own noise can be believed.
fn trust(report: &Report) -> Option<String> {
    let claims = || offered(report).map(|(method, _)| method).filter(|method| method.claim.is_some());
    let wrong: Vec<String> = claims().filter(|method| method.claims_wrongly()).map(claim_text).collect();
    match (claims().count(), wrong.is_empty()) {
        (0, _) => None,
        (_, true) => {
            Some(format!("the noise that bakes state holds: within a factor of {HONEST} of what repeats show"))
        }
        (_, false) => Some(format!("{WRONG}: {}", wrong.join("; "))),
    }
}

/// How a line begins that says that bakes claim too little, or too much.
pub const WRONG: &str = "do not trust the noise that bakes state";

fn claim_text(method: &Method) -> String {
    let claim = method.claim.unwrap_or(1.0);
    let how = if claim < 1.0 {
        format!("{} times too small", number(1.0 / claim))
    } else {
        format!("{} times too large", number(claim))
    };
    format!("{} states it {how} at worst", method.name)
}

/// What is wrong between nodes, and whether more directions help.
fn between_nodes(report: &Report) -> Option<String> {
    let offered = offered(report).map(|(method, _)| method);
    let best = offered.filter(|method| method.points.iter().all(|point| point.seen.is_some()));
    let last =
        |method: &&Method| method.points.last().and_then(|point| point.seen).map_or(f64::INFINITY, |seen| seen.p95);
    let method = best.min_by(|a, b| last(a).total_cmp(&last(b)))?;
    let ends = [method.points.first()?, method.points.last()?];
    let [first, most] = ends.map(|point| point.seen.unwrap_or_default());
    let helps = match method.points.len() {
        1 => "",
        _ if most.p95 > 0.8 * first.p95 => ": more directions do not help, nodes closer to each other may (--spacing)",
        _ if most.p95 > 5.0 * report.study.target => {
            ": what is left of it is for closer nodes (--spacing) more than for directions"
        }
        _ => "",
    };
    Some(format!(
        "between nodes, as an engine reads the file, {} is off by {} (median), {} (95th percentile) with {} directions, {} and {} with {}{helps}",
        method.name,
        percent(first.median),
        percent(first.p95),
        ends[0].budget,
        percent(most.median),
        percent(most.p95),
        ends[1].budget
    ))
}

fn capture_lines(study: &Study) -> Vec<String> {
    let Some(capture) = &study.capture else { return Vec::new() };
    let cost = format!("capturing the probes takes about {} s of CPU ({})", number(capture.cpu_seconds), capture.about);
    let pays = match study.break_even {
        Some(BreakEven::Nodes(nodes)) => {
            format!("break-even: with that, gdibl takes less than path from {} nodes on", grouped(nodes))
        }
        Some(BreakEven::Never) => {
            "break-even: never; path takes less per node, even with the capture for nothing".into()
        }
        None => {
            let fails = |name: &&str| study.methods.iter().any(|own| own.name == *name && own.at_noise.is_none());
            let Some(name) = [GDIBL, PATH].into_iter().find(fails) else { return vec![cost] };
            format!("break-even: not known; {name} does not come to {} noise", round_percent(study.target))
        }
    };
    vec![cost, pays]
}

pub fn cost_text(at: CostAt) -> String {
    let how = if at.extrapolated { " (extrapolated)" } else { "" };
    format!("{} ms{how}", number(at.milliseconds_per_node))
}

/// `12 times less than`.
pub fn times_text(times: f64) -> String {
    if times >= 1.0 {
        format!("{} times less than", number(times))
    } else {
        format!("{} times more than", number(1.0 / times))
    }
}

/// A floor, and whether it is in the way.
fn floor_text(floor: &Floor, target: f64) -> String {
    let range = floor_range(floor);
    if floor.low >= target {
        format!("bias {range}: its error never comes to {}", round_percent(target))
    } else if floor.low > 0.0 && floor.middle >= target {
        format!("bias {range}: its error hardly comes to {}", round_percent(target))
    } else {
        format!("bias {range}")
    }
}

/// `0.31 % (0.25 to 0.36 %)`.
pub fn floor_range(floor: &Floor) -> String {
    if floor.low > 0.0 {
        format!("{} ({} to {})", percent(floor.middle), number(100.0 * floor.low), percent(floor.high))
    } else {
        format!("under {}", percent(floor.high))
    }
}

pub fn reference_noise_text(study: &Study) -> String {
    match study.reference_noise {
        Some(noise) => format!("; its own noise is {}", percent(noise)),
        None => "; its own noise is not known, and counts as bias".into(),
    }
}

/// Three significant digits.
pub fn percent(share: f64) -> String {
    format!("{} %", number(100.0 * share))
}

/// 1 %, 0.5 %: without needless digits, for what was asked for.
pub fn round_percent(share: f64) -> String {
    let text = number(100.0 * share);
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text} %")
}

/// Three significant digits.
pub fn number(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let digits = (2 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.digits$}")
}

/// 5 200.
pub fn grouped(value: u64) -> String {
    let digits = value.to_string();
    let group = |(i, digit): (usize, char)| {
        let gap = i > 0 && (digits.len() - i).is_multiple_of(3);
        gap.then_some('\u{202f}').into_iter().chain([digit])
    };
    digits.chars().enumerate().flat_map(group).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits_that_count() {
        let numbers = [0.0, 0.001234, 0.5, 9.996, 12.34, 123.4, 43210.0, f64::INFINITY].map(number);
        assert_eq!(numbers, ["0", "0.00123", "0.500", "10.00", "12.3", "123", "43210", "inf"]);
        assert_eq!([0.01, 0.005, 0.1].map(round_percent), ["1 %", "0.5 %", "10 %"]);
        assert_eq!([7, 999, 5200, 1_234_567].map(grouped), ["7", "999", "5\u{202f}200", "1\u{202f}234\u{202f}567"]);
        assert_eq!(
            [12.3, 1.0, 0.5].map(times_text),
            ["12.3 times less than", "1.00 times less than", "2.00 times more than"]
        );
    }

    #[test]
    fn directions_are_rounded_up_to_two_digits() {
        assert_eq!([0.3, 1.0, 9.2, 64.1, 1420.0, 1501.0, 65_536.0].map(directions), [1, 1, 10, 65, 1500, 1600, 66_000]);
    }

    #[test]
    fn floors_say_whether_they_are_in_the_way() {
        let floor = |low, middle, high| floor_text(&Floor { middle, low, high }, 0.01);
        assert_eq!(floor(0.0, 0.02, 0.03), "bias under 3.00 %");
        assert_eq!(floor(0.001, 0.002, 0.003), "bias 0.200 % (0.100 to 0.300 %)");
        assert!(floor(0.005, 0.011, 0.013).ends_with(": its error hardly comes to 1 %"));
        assert!(floor(0.02, 0.021, 0.022).ends_with(": its error never comes to 1 %"));
    }
}
