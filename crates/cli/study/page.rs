//! What a study writes for people and for tables: one HTML page without anything outside of it, and a CSV.

use gdibl_baker::Finding;
use gdibl_baker::analyse::study::{CostAt, Method, PATH, Seen, Spread, Study};
use std::fmt::Write;

use super::report::Report;
use super::words::{
    WRONG, cost_text, floor_range, grouped, never, number, percent, reference_noise_text, round_percent, times_text,
    verdict,
};

const STYLE: &str = "body{font:16px/1.5 system-ui,'DejaVu Sans',sans-serif;color:#1b1f24;background:#fff;max-width:1180px;\
margin:2rem auto;padding:0 1rem}h1{font-size:1.6rem;margin-bottom:.2rem}h2{font-size:1.2rem;margin-top:2rem}\
.under{color:#57606a;margin-top:0}table{border-collapse:collapse;font-size:13px}\
th,td{text-align:right;padding:.22rem .6rem;border-bottom:1px solid #e5e8eb;font-variant-numeric:tabular-nums}\
th{border-bottom:2px solid #8a939c;vertical-align:bottom}th:first-child,td:first-child,td.words{text-align:left}\
tr.first td{border-top:1px solid #8a939c}.verdict{background:#f3f6f9;padding:.8rem 1rem;border-radius:6px}\
.verdict p{margin:.2rem 0}.verdict p.inner{margin-left:1.2rem}svg{width:100%;max-width:1000px;height:auto}dt{font-weight:600}dd{margin:0 0 .4rem 0}\
.wrong{color:#b3261e;font-weight:600}.advice{font-size:1.1rem;font-weight:600}.wide{overflow-x:auto}td{white-space:nowrap}td.words{white-space:normal;min-width:14rem}";

/// Text as HTML and SVG take it.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The page.
pub fn html(report: &Report, figure: &str, findings: &[Finding]) -> String {
    let title = format!("Error against run time: {}", escape(&report.level));
    // Inline SVG needs no namespace.
    let figure = figure.replacen(" xmlns=\"http://www.w3.org/2000/svg\"", "", 1);
    [
        format!("<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title>"),
        "<meta name=\"viewport\" content=\"width=device-width\">".into(),
        format!("<style>{STYLE}</style></head><body>"),
        format!("<h1>{title}</h1>"),
        format!(
            "<p class=\"under\">{}; {}, {}; {} repeats of everything</p>",
            escape(&report.light),
            escape(&report.places),
            report.sh,
            report.repeats
        ),
        verdict_html(report),
        "<h2>Error against run time</h2>".into(),
        figure,
        how_to_read(report),
        "<h2>By method</h2>".into(),
        methods_table(&report.study),
        "<h2>Every measurement</h2>".into(),
        points_table(&report.study),
        what_was_measured(report, findings),
        "</body></html>\n".into(),
    ]
    .join("\n")
}

fn verdict_html(report: &Report) -> String {
    let line = |line: &String| match line.strip_prefix("  ") {
        Some(inner) => format!("<p class=\"inner\">{}</p>", escape(inner)),
        None if line.starts_with("advice: ") => format!("<p class=\"advice\">{}</p>", escape(line)),
        None if line.starts_with(WRONG) => format!("<p class=\"wrong\">{}</p>", escape(line)),
        None => format!("<p>{}</p>", escape(line)),
    };
    let lines: Vec<String> = verdict(report).iter().map(line).collect();
    format!("<div class=\"verdict\">{}</div>", lines.join("\n"))
}

/// What a person must know who sees such a picture for the first time.
const HOW_TO_READ: [(&str, &str); 9] = [
    (
        "Axes",
        "to the right: processor time for one node, all threads added up; upwards: how wrong its irradiance is, \
         as a share of its root mean square over all places. Both are logarithmic. Further down and to the left \
         is better.",
    ),
    (
        "Points",
        "one for each number of directions per node, fewest on the left. Bars: the least and the most of the \
         repeats, in time and in error; where none is seen, they are smaller than the mark.",
    ),
    (
        "Grey slanted lines",
        "slope −1/2, as random directions have it: half the error takes four times the time. All along one a \
         method is equally efficient; on the next one down it is ten times as efficient. A line that falls \
         steeper gains with more directions.",
    ),
    (
        "Upper picture",
        "the whole error, as gdibl compare tells it: noise, what the method gets wrong for good, and the \
         reference's own noise. In the grey zone at the bottom, where there is one, the reference is no surer \
         than that.",
    ),
    (
        "Bias floor",
        "dotted at the right: the error that is left with any number of directions. It is reckoned from products \
         of different repeats, in which noise drops out, less the reference's own noise; in brackets two standard \
         deviations. Not drawn where chance alone could make it. Where all methods share it, path tracing too, \
         the reference may be what is off.",
    ),
    (
        "Lower picture",
        "noise alone: how repeats differ from each other; no reference is needed. Dashed: what the bakes \
         themselves expect, without knowing of each other. Where both lie together, they are honest.",
    ),
    (
        "Between nodes",
        "how wrong the light is where an engine draws: at places between the nodes, in the air and on surfaces, read \
         from the packed file as the runtime does, relative to the light there; the larger of air and surfaces.",
    ),
    (
        "Known by luck",
        "where rare, very bright directions decide (a sun, met without importance), noise jumps up and down, and \
         a few repeats tell neither it nor a bias.",
    ),
    (
        "Capture",
        "probes of a level that has none are made by path tracing first; gdibl with capture shares that cost \
         among all nodes, gdibl leaves it out. Where the probes that were given are cleaner than such a capture \
         makes them, captured ones would be somewhat worse than these.",
    ),
];

fn how_to_read(report: &Report) -> String {
    let target = format!("the error of {} at which methods are compared.", round_percent(report.study.target));
    let items = HOW_TO_READ.into_iter().chain([("Horizontal line", target.as_str())]);
    let items: Vec<String> = items.map(|(name, text)| format!("<dt>{name}</dt><dd>{}</dd>", escape(text))).collect();
    format!("<h2>How to read it</h2>\n<dl>{}</dl>", items.join("\n"))
}

fn methods_table(study: &Study) -> String {
    let target = round_percent(study.target);
    let row = |method: &Method| {
        let at = |cost: Option<CostAt>, never: &str| cost.map_or(never.to_string(), cost_text);
        let claim = method.claim.map_or("not known".into(), |claim| format!("{claim:.2}"));
        let cells = [
            at(method.at_noise, never(method)),
            method
                .times_less
                .filter(|_| method.name != PATH)
                .map_or(String::new(), |times| times_text(times).replace(" than", "")),
            at(method.at_error, if method.floor.low >= study.target { "never" } else { never(method) }),
            method.total_seconds.map_or(String::new(), |seconds| format!("{} s", number(seconds))),
            if method.claims_wrongly() { format!("<span class=\"wrong\">{claim}</span>") } else { claim },
            floor_range(&method.floor),
            method.slope.map_or(String::new(), |slope| format!("{slope:.2}").replace('-', "−")),
        ];
        let cells: Vec<String> = cells.iter().map(|cell| format!("<td>{cell}</td>")).collect();
        format!(
            "<tr><td>{}</td>{}<td class=\"words\">{}</td></tr>",
            escape(&method.name),
            cells.join(""),
            escape(&method.about)
        )
    };
    let rows: Vec<String> = study.methods.iter().map(row).collect();
    format!(
        "<div class=\"wide\"><table><tr><th>method</th><th>CPU per node at {target} noise</th><th>beside path</th><th>at \
         {target} true error</th><th>all {} nodes, with set-up</th><th>stated over shown noise</th><th>bias floor</th><th>slope of noise</th><th></th></tr>\n{}</table></div>",
        study.nodes,
        rows.join("\n")
    )
}

fn points_table(study: &Study) -> String {
    let mut rows = String::new();
    for method in &study.methods {
        for (i, point) in method.points.iter().enumerate() {
            let cells = [
                point.budget.to_string(),
                number(point.milliseconds_per_node.middle),
                format!(
                    "{} ({} to {})",
                    number(point.cpu_seconds.middle),
                    number(point.cpu_seconds.least),
                    number(point.cpu_seconds.most)
                ),
                number(point.wall_seconds.middle),
                number(point.setup_seconds),
                format!("{:.1}", point.rays as f64 / point.samples as f64),
                range(point.error),
                range(point.noise),
                point.estimated.map_or("unknown".into(), percent),
                point.seen.map_or(String::new(), |seen| format!("{}, {}", percent(seen.median), percent(seen.p95))),
                grouped(point.bytes),
                number(point.efficiency),
            ];
            let first = if i == 0 { " class=\"first\"" } else { "" };
            let cells: Vec<String> = cells.iter().map(|cell| format!("<td>{cell}</td>")).collect();
            writeln!(rows, "<tr{first}><td>{}</td>{}</tr>", escape(&method.name), cells.join(""))
                .expect("strings take all");
        }
    }
    format!(
        "<div class=\"wide\"><table><tr><th>method</th><th>directions per node</th><th>CPU ms per node</th><th>CPU s (least to \
         most)</th><th>wall s</th><th>set-up, CPU s</th><th>rays per direction</th><th>error (least to most)</th><th>noise \
         (least to most)</th><th>stated</th><th>between nodes: median, 95 %</th><th>bytes</th><th>1/(error² · CPU s per node)</th></tr>\n{rows}</table></div>"
    )
}

/// `1.2 % (1.1 to 1.3)`.
fn range(error: Spread) -> String {
    format!("{} ({} to {})", percent(error.middle), number(100.0 * error.least), number(100.0 * error.most))
}

fn what_was_measured(report: &Report, findings: &[Finding]) -> String {
    let Report { seeds: [first, last], .. } = report;
    let mut items = vec![
        ("Level", format!("{}; {}", report.level, report.light)),
        ("Nodes", format!("{}; {} compared with the reference", report.places, report.study.places)),
        ("Reference", format!("{}{}", report.reference.about, reference_noise_text(&report.study))),
        (
            "Repeats",
            format!(
                "{} of each method with each number of directions, by seeds {first} to {last}; times are medians, errors root \
                 mean squares. Times are those of the bake alone; set-up, which builds what is needed to trace rays, is apart",
                report.repeats
            ),
        ),
        ("Machine", format!("{}, {} threads", report.processor, report.threads)),
        ("Program", report.program.to_string()),
        ("The study took", format!("{:.0} s, {:.0} s of CPU", report.wall_seconds, report.cpu_seconds)),
    ];
    if let Some(capture) = &report.study.capture {
        items.push(("Capture", format!("{} s of CPU: {}", number(capture.cpu_seconds), capture.about)));
    }
    for left in &report.left_out {
        items.push(("Left out", format!("{}: {}", left.method, left.why)));
    }
    for finding in findings {
        items.push(("Found", format!("{}: {}", finding.id, finding.message)));
    }
    let items: Vec<String> =
        items.iter().map(|(name, text)| format!("<dt>{name}</dt><dd>{}</dd>", escape(text))).collect();
    format!("<h2>What was measured</h2>\n<dl>{}</dl>", items.join("\n"))
}

/// One row per method and budget. Errors are shares, times as named.
pub fn csv(study: &Study) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let head = "method,directions_per_node,cpu_ms_per_node,cpu_seconds,cpu_seconds_least,cpu_seconds_most,wall_seconds,\
                wall_seconds_least,wall_seconds_most,setup_cpu_seconds,rays,samples,error,error_least,error_most,noise,\
                noise_least,noise_most,estimated,between_median,between_p95,bytes,bias_square,efficiency,noise_efficiency";
    writer.write_record(head.split(',')).expect("memory takes all");
    for method in &study.methods {
        for point in &method.points {
            let spread = |s: Spread| [s.middle, s.least, s.most].map(|v| v.to_string());
            let mut row = vec![method.name.clone(), point.budget.to_string()];
            row.push(point.milliseconds_per_node.middle.to_string());
            row.extend(spread(point.cpu_seconds));
            row.extend(spread(point.wall_seconds));
            row.extend([point.setup_seconds.to_string(), point.rays.to_string(), point.samples.to_string()]);
            row.extend(spread(point.error));
            row.extend(spread(point.noise));
            row.push(point.estimated.map_or(String::new(), |e| e.to_string()));
            let seen = |of: fn(Seen) -> f64| point.seen.map_or(String::new(), |seen| of(seen).to_string());
            row.extend([seen(|seen| seen.median), seen(|seen| seen.p95)]);
            row.push(point.bytes.to_string());
            row.extend([point.bias_square, point.efficiency, point.noise_efficiency].map(|v| v.to_string()));
            writer.write_record(&row).expect("memory takes all");
        }
    }
    String::from_utf8(writer.into_inner().expect("memory takes all")).expect("text")
}
