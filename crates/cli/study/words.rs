//! A study in words: for the terminal, and for the page.

use gdibl_baker::analyse::study::{BreakEven, CostAt, Floor, GDIBL, PATH, Study};

use super::report::Report;

/// A table of every measurement, and what it comes to.
pub fn report(report: &Report) -> String {
    let Report { study, .. } = report;
    let width = study.methods.iter().map(|method| method.name.chars().count()).max().unwrap_or(0);
    let mut lines = vec![format!("{}, {}: {}, {}", report.level, report.light, report.places, report.sh)];
    lines.push(format!("  reference  {}{}", report.reference.about, reference_noise_text(study)));
    lines.push(String::new());
    lines.push(format!(
        "  {:width$} {:>10} {:>12} {:>10} {:>19} {:>9} {:>9}",
        "", "directions", "CPU ms/node", "error", "(least to most)", "noise", "estimated"
    ));
    for method in &study.methods {
        for point in &method.points {
            let range = format!("({} to {})", number(100.0 * point.error.least), percent(point.error.most));
            lines.push(format!(
                "  {:width$} {:>10} {:>12} {:>10} {range:>19} {:>9} {:>9}",
                method.name,
                point.budget,
                number(point.milliseconds_per_node.middle),
                percent(point.error.middle),
                percent(point.noise.middle),
                point.estimated.map_or("unknown".into(), percent),
            ));
        }
    }
    lines.push(String::new());
    lines.extend(verdict(report).into_iter().map(|line| format!("  {line}")));
    lines.join("\n")
}

/// What it comes to, line by line.
pub fn verdict(report: &Report) -> Vec<String> {
    let study = &report.study;
    let mut lines =
        vec![format!("CPU time per node at {} noise, and the bias that is left then:", round_percent(study.target))];
    for method in &study.methods {
        let beside = match (method.times_less, method.name.as_str()) {
            (_, PATH) | (None, _) => String::new(),
            (Some(times), _) => format!(", {} {PATH}", times_text(times)),
        };
        let at = method.at_noise.map_or("not known, its noise does not fall with more directions".into(), cost_text);
        let luck = if method.erratic { "; known by luck: its noise jumps, rare bright directions decide" } else { "" };
        lines.push(format!("  {}: {at}{beside}; {}{luck}", method.name, floor_text(&method.floor, study.target)));
    }
    lines.extend(capture_lines(study));
    lines.extend(report.left_out.iter().map(|left| format!("left out: {}: {}", left.method, left.why)));
    lines
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
            let comes = |name| study.methods.iter().find(|method| method.name == name).map(|m| m.at_noise.is_some());
            let Some(false) = comes(GDIBL) else { return vec![cost] };
            format!("break-even: not known; gdibl does not come to {} noise", round_percent(study.target))
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
    fn floors_say_whether_they_are_in_the_way() {
        let floor = |low, middle, high| floor_text(&Floor { middle, low, high }, 0.01);
        assert_eq!(floor(0.0, 0.02, 0.03), "bias under 3.00 %");
        assert_eq!(floor(0.001, 0.002, 0.003), "bias 0.200 % (0.100 to 0.300 %)");
        assert!(floor(0.005, 0.011, 0.013).ends_with(": its error hardly comes to 1 %"));
        assert!(floor(0.02, 0.021, 0.022).ends_with(": its error never comes to 1 %"));
    }
}
