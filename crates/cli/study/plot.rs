//! The figure of a study as SVG: error, and noise alone, against CPU time per node, both logarithmic.
//!
//! Written by hand: names beside lines without overlap, spread in both directions and lines of equal efficiency are what it is
//! about, and no plotting crate has them.

use gdibl_baker::analyse::study::{GDIBL, GDIBL_WITH_CAPTURE, Method, PATH, Point, Spread, Study};
use std::fmt::Write;

use super::page::escape;
use super::words::{percent, round_percent};

const WIDTH: f64 = 1000.0;
const PANEL_HEIGHT: f64 = 560.0;
/// Of the plot inside its panel; names stand to the right.
const LEFT: f64 = 86.0;
const RIGHT: f64 = 706.0;
const TOP: f64 = 46.0;
const BOTTOM: f64 = 500.0;
/// Length of the words at a slanted line, and some.
const WORDS: f64 = 340.0;
/// Height of a name.
const LINE: f64 = 19.0;

/// Told apart by people who see colours differently: Okabe and Ito's for what matters most, Paul Tol's muted ones for the
/// rest; every line has its own marker besides.
const MAIN: [(&str, &str); 3] = [(GDIBL, "#0072b2"), (GDIBL_WITH_CAPTURE, "#009e9e"), (PATH, "#d55e00")];
const OTHERS: [&str; 9] =
    ["#cc6677", "#332288", "#999933", "#117733", "#882255", "#44aa99", "#aa4499", "#b08d00", "#666666"];

/// How a method is drawn.
struct Style {
    colour: &'static str,
    width: f64,
    marker: usize,
}

fn style(methods: &[Method], index: usize) -> Style {
    let main = |name: &str| MAIN.iter().position(|(main, _)| *main == name);
    match main(&methods[index].name) {
        Some(i) => Style { colour: MAIN[i].1, width: 2.8, marker: i },
        None => {
            let number = methods[..index].iter().filter(|method| main(&method.name).is_none()).count();
            Style { colour: OTHERS[number % OTHERS.len()], width: 1.6, marker: MAIN.len() + number }
        }
    }
}

/// What a panel shows.
struct Panel<'a> {
    study: &'a Study,
    title: &'a str,
    y_label: &'a str,
    value: fn(&Point) -> Spread,
    /// Dashed beside each line.
    estimated: bool,
    /// Where each method ends with any number of directions, and where the reference stops telling.
    floors: bool,
    top: f64,
    x: Axis,
    y: Axis,
}

/// A logarithmic axis, from value to place.
#[derive(Clone, Copy)]
struct Axis {
    values: [f64; 2],
    places: [f64; 2],
}

impl Axis {
    /// Around all values, with room; positive ones count.
    fn around(values: impl Iterator<Item = f64>, places: [f64; 2]) -> Axis {
        let usable = values.filter(|v| *v > 0.0 && v.is_finite());
        let (least, most) = usable.fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
        let (least, most) = if least <= most { (least, most) } else { (0.1, 10.0) };
        Axis { values: [least / 1.4, most * 1.4], places }
    }

    fn place(&self, value: f64) -> f64 {
        let [a, b] = self.values.map(f64::ln);
        let share = (value.max(f64::MIN_POSITIVE).ln() - a) / (b - a);
        self.places[0] + share * (self.places[1] - self.places[0])
    }

    fn holds(&self, value: f64) -> bool {
        (self.values[0]..=self.values[1]).contains(&value)
    }

    /// 1, 2 and 5 of every decade; which are labelled: all, or powers of ten where there are many.
    fn ticks(&self) -> Vec<(f64, bool)> {
        let [first, last] = self.values.map(|v| v.log10().floor() as i32);
        let all = (first..=last).flat_map(|decade| [1.0, 2.0, 5.0].map(|digit| (digit, digit * 10f64.powi(decade))));
        let few = last - first <= 3;
        all.filter(|(_, value)| self.holds(*value)).map(|(digit, value)| (value, few || digit == 1.0)).collect()
    }
}

/// Both panels, one above the other.
pub fn figure(study: &Study) -> String {
    let points = || study.methods.iter().flat_map(|method| &method.points);
    let x = Axis::around(
        points().flat_map(|p| [p.milliseconds_per_node.least, p.milliseconds_per_node.most]),
        [LEFT, RIGHT],
    );
    let error = |p: &Point| p.error;
    let noise = |p: &Point| p.noise;
    let y = |values: Vec<f64>| Axis::around(values.into_iter().chain([study.target]), [BOTTOM, TOP]);
    let panels = [
        Panel {
            study,
            title: "True error, against the reference",
            y_label: "relative RMSE of irradiance",
            value: error,
            estimated: false,
            floors: true,
            top: 0.0,
            x,
            y: y(points().flat_map(|p| [p.error.least, p.error.most]).collect()),
        },
        Panel {
            study,
            title: "Noise alone, between repeats",
            y_label: "relative standard deviation of irradiance",
            value: noise,
            estimated: true,
            floors: false,
            top: PANEL_HEIGHT,
            x,
            y: y(points().flat_map(|p| [p.noise.least, p.noise.most, p.estimated.unwrap_or(0.0)]).collect()),
        },
    ];
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {}\" role=\"img\" font-family=\"system-ui, \
         'DejaVu Sans', sans-serif\" font-size=\"13\">\n<title>Error against CPU time per node, by method</title>\n<rect \
         width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n",
        2.0 * PANEL_HEIGHT
    );
    panels.iter().for_each(|panel| panel.draw(&mut svg));
    svg += "</svg>\n";
    svg
}

impl Panel<'_> {
    fn draw(&self, svg: &mut String) {
        put(svg, format_args!("<g transform=\"translate(0 {})\">", self.top));
        let clip = if self.floors { "error" } else { "noise" };
        let (width, height) = (RIGHT - LEFT, BOTTOM - TOP);
        put(
            svg,
            format_args!(
                "<clipPath id=\"{clip}\"><rect x=\"{LEFT}\" y=\"{TOP}\" width=\"{width}\" height=\"{height}\"/></clipPath>"
            ),
        );
        text(svg, [LEFT, 26.0], "font-size=\"17\" font-weight=\"600\"", self.title);
        self.draw_axes(svg);
        put(svg, format_args!("<g clip-path=\"url(#{clip})\" fill=\"none\">"));
        self.draw_efficiency(svg);
        self.draw_target(svg);
        // The main ones last, on top.
        let order = self.order();
        order.iter().rev().for_each(|&index| self.draw_method(svg, index));
        svg.push_str("</g>\n");
        self.draw_names(svg);
        svg.push_str("</g>\n");
    }

    fn draw_axes(&self, svg: &mut String) {
        let y_middle = 0.5 * (TOP + BOTTOM);
        for (value, labelled) in self.x.ticks() {
            let x = self.x.place(value);
            put(svg, format_args!("<path d=\"M{x:.1} {TOP}V{BOTTOM}\" stroke=\"#eee\"/>"));
            if labelled {
                text(svg, [x, BOTTOM + 18.0], "text-anchor=\"middle\" fill=\"#333\"", &tick(value));
            }
        }
        for (value, labelled) in self.y.ticks() {
            let y = self.y.place(value);
            put(svg, format_args!("<path d=\"M{LEFT} {y:.1}H{RIGHT}\" stroke=\"#eee\"/>"));
            if labelled {
                let label = format!("{} %", tick(100.0 * value));
                text(svg, [LEFT - 8.0, y + 4.5], "text-anchor=\"end\" fill=\"#333\"", &label);
            }
        }
        let x_middle = 0.5 * (LEFT + RIGHT);
        let place = [x_middle, BOTTOM + 40.0];
        text(svg, place, "text-anchor=\"middle\" fill=\"#333\"", "CPU milliseconds per node, all threads together");
        let turned = format!("text-anchor=\"middle\" fill=\"#333\" transform=\"rotate(-90 16 {y_middle})\"");
        text(svg, [16.0, y_middle], &turned, self.y_label);
        put(
            svg,
            format_args!(
                "<path d=\"M{LEFT} {TOP}V{BOTTOM}H{RIGHT}\" fill=\"none\" stroke=\"#888\" stroke-width=\"1.2\"/>"
            ),
        );
    }

    /// Lines of slope -1/2, each ten times as efficient as the next: error² × time is the same all along one.
    fn draw_efficiency(&self, svg: &mut String) {
        let [x0, x1] = self.x.values;
        let corner = |x: f64, y: f64| (x * y * y).log10();
        let [y0, y1] = self.y.values;
        for decade in corner(x0, y0).ceil() as i32..=corner(x1, y1).floor() as i32 {
            let y = |x: f64| self.y.place((10f64.powi(decade) / x).sqrt());
            let [from, to] = [x0, x1].map(y);
            put(
                svg,
                format_args!("<path d=\"M{LEFT} {from:.1}L{RIGHT} {to:.1}\" stroke=\"#cfd4da\" stroke-width=\"1\"/>"),
            );
        }
        // The uppermost that is long enough has the words, above it.
        let segment = |decade: i32| {
            let at = |x: f64| [self.x.place(x), self.y.place((10f64.powi(decade) / x).sqrt())];
            let (a, b) = (at(x0), at(x1));
            // The part of it inside the picture, as shares of its way.
            let [from, to] = [TOP, BOTTOM].map(|y| ((y - a[1]) / (b[1] - a[1])).clamp(0.0, 1.0));
            [from, to].map(|share| [0, 1].map(|axis| a[axis] + share * (b[axis] - a[axis])))
        };
        let segments = (corner(x0, y0).floor() as i32..=corner(x1, y1).ceil() as i32).rev().map(segment);
        let length = |[a, b]: &[[f64; 2]; 2]| (b[0] - a[0]).hypot(b[1] - a[1]);
        let Some([a, b]) = segments.into_iter().find(|segment| length(segment) > WORDS) else { return };
        let angle = (b[1] - a[1]).atan2(b[0] - a[0]);
        let [x, y] = [0, 1].map(|axis| 0.5 * (a[axis] + b[axis]));
        let turned = format!(
            "text-anchor=\"middle\" fill=\"#8a939c\" font-size=\"12\" transform=\"rotate({:.2} {x:.1} {y:.1}) \
             translate(0 -5)\"",
            angle.to_degrees()
        );
        text(svg, [x, y], &turned, "slope −1/2: four times the time, half the error");
    }

    fn draw_target(&self, svg: &mut String) {
        let y = self.y.place(self.study.target);
        put(svg, format_args!("<path d=\"M{LEFT} {y:.1}H{RIGHT}\" stroke=\"#222\" stroke-width=\"1.1\"/>"));
        text(svg, [LEFT + 6.0, y - 5.0], "fill=\"#222\" font-size=\"12\"", &round_percent(self.study.target));
        if let Some(noise) = self.study.reference_noise.filter(|noise| self.floors && *noise > self.y.values[0]) {
            let y = self.y.place(noise);
            put(
                svg,
                format_args!(
                    "<rect x=\"{LEFT}\" y=\"{y:.1}\" width=\"{}\" height=\"{:.1}\" fill=\"#000\" fill-opacity=\"0.07\"/>",
                    RIGHT - LEFT,
                    BOTTOM - y
                ),
            );
            let label = format!("under the reference's own noise, {}", percent(noise));
            text(svg, [LEFT + 6.0, y + 15.0], "fill=\"#555\" font-size=\"12\"", &label);
        }
    }

    fn draw_method(&self, svg: &mut String, index: usize) {
        let method = &self.study.methods[index];
        let Style { colour, width, marker } = style(&self.study.methods, index);
        let place = |point: &Point, value: f64| [self.x.place(point.milliseconds_per_node.middle), self.y.place(value)];
        let line = |value: &dyn Fn(&Point) -> Option<f64>| {
            let places =
                method.points.iter().filter_map(|point| Some(place(point, value(point).filter(|v| *v > 0.0)?)));
            let parts: Vec<String> = places.map(|[x, y]| format!("{x:.1} {y:.1}")).collect();
            format!("M{}", parts.join("L"))
        };
        let middle = |point: &Point| Some((self.value)(point).middle);
        put(
            svg,
            format_args!(
                "<path d=\"{}\" stroke=\"{colour}\" stroke-width=\"{width}\" stroke-linejoin=\"round\"/>",
                line(&middle)
            ),
        );
        if self.estimated && method.points.iter().any(|point| point.estimated.is_some_and(|e| e > 0.0)) {
            let estimated = line(&|point: &Point| point.estimated);
            put(
                svg,
                format_args!(
                    "<path d=\"{estimated}\" stroke=\"{colour}\" stroke-width=\"1.4\" stroke-dasharray=\"6 4\"/>"
                ),
            );
        }
        for point in &method.points {
            let value = (self.value)(point);
            let [x, y] = place(point, value.middle);
            let time = point.milliseconds_per_node;
            let [x0, x1] = [time.least, time.most].map(|v| self.x.place(v));
            let [y0, y1] = [value.least, value.most].map(|v| self.y.place(v));
            put(svg, format_args!("<path d=\"M{x:.1} {y0:.1}V{y1:.1}M{x0:.1} {y:.1}H{x1:.1}\" stroke=\"{colour}\"/>"));
            put(svg, format_args!("{}", marker_at(marker, [x, y], colour)));
        }
        if let (true, Some(last)) = (self.floors && method.floor.low > 0.0, method.points.last()) {
            let [x, _] = place(last, 1.0);
            let y = self.y.place(method.floor.middle);
            put(
                svg,
                format_args!(
                    "<path d=\"M{x:.1} {y:.1}H{RIGHT}\" stroke=\"{colour}\" stroke-width=\"1.6\" \
                     stroke-dasharray=\"1.5 3.5\"/>"
                ),
            );
        }
    }

    /// Methods as they shall be read: those that matter most, then by what they come to, the worst first.
    fn order(&self) -> Vec<usize> {
        let methods = &self.study.methods;
        let rank = |index: &usize| {
            let method = &methods[*index];
            let main = MAIN.iter().position(|(name, _)| *name == method.name).unwrap_or(MAIN.len());
            let last = method.points.last().map_or(0.0, |point| (self.value)(point).middle);
            (main, last)
        };
        let mut order: Vec<usize> = (0..methods.len()).collect();
        order.sort_by(|a, b| {
            let ((main_a, last_a), (main_b, last_b)) = (rank(a), rank(b));
            main_a.cmp(&main_b).then(last_b.total_cmp(&last_a))
        });
        order
    }

    /// Each with its line and marker, and what it comes to.
    fn draw_names(&self, svg: &mut String) {
        let x = RIGHT + 18.0;
        let mut y = TOP + 8.0;
        for index in self.order() {
            let method = &self.study.methods[index];
            let Style { colour, width, marker } = style(&self.study.methods, index);
            put(
                svg,
                format_args!("<path d=\"M{x} {y}h26\" stroke=\"{colour}\" stroke-width=\"{width}\" fill=\"none\"/>"),
            );
            put(svg, format_args!("{}", marker_at(marker, [x + 13.0, y], colour)));
            let weight = if width > 2.0 { "font-weight=\"600\"" } else { "" };
            text(svg, [x + 34.0, y + 4.5], weight, &method.name);
            y += LINE;
            let note = match self.floors {
                _ if method.erratic => Some("known by luck".into()),
                true => (method.floor.low > 0.0).then(|| format!("floor {}", percent(method.floor.middle))),
                false => method.slope.map(|slope| format!("slope {slope:.2}").replace('-', "−")),
            };
            if let Some(note) = note {
                text(svg, [x + 34.0, y + 2.5], "fill=\"#666\" font-size=\"11.5\"", &note);
                y += LINE - 3.0;
            }
        }
        y += 12.0;
        let keys: &[(&str, &str)] = match self.floors {
            true => &[
                ("stroke-width=\"1\"", "spread of repeats"),
                ("stroke-dasharray=\"1.5 3.5\" stroke-width=\"1.6\"", "bias floor"),
            ],
            false => &[
                ("stroke-width=\"1\"", "spread of repeats"),
                ("stroke-dasharray=\"6 4\" stroke-width=\"1.4\"", "what bakes estimate themselves"),
            ],
        };
        for (how, words) in keys {
            put(svg, format_args!("<path d=\"M{x} {y}h26\" stroke=\"#555\" fill=\"none\" {how}/>"));
            text(svg, [x + 34.0, y + 4.5], "fill=\"#555\" font-size=\"12\"", words);
            y += LINE;
        }
    }
}

/// One of ten shapes: they go round.
fn marker_at(marker: usize, [x, y]: [f64; 2], colour: &str) -> String {
    let r = 4.2;
    let path =
        |d: String, fill: &str| format!("<path d=\"{d}\" fill=\"{fill}\" stroke=\"{colour}\" stroke-width=\"1.4\"/>");
    let fill = if marker.is_multiple_of(2) { colour } else { "#fff" };
    match marker % 10 {
        0 => format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{r}\" fill=\"{colour}\" stroke=\"{colour}\"/>"),
        1 => format!(
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{r}\" fill=\"#fff\" stroke=\"{colour}\" stroke-width=\"1.8\"/>"
        ),
        2 => path(format!("M{:.1} {:.1}h{s}v{s}h-{s}z", x - 4.0, y - 4.0, s = 8.0), colour),
        3 | 4 => path(format!("M{x:.1} {:.1}l5 8.5h-10z", y - 5.5), fill),
        5 | 6 => path(format!("M{x:.1} {:.1}l5.2 5.2l-5.2 5.2l-5.2 -5.2z", y - 5.2), fill),
        7 => path(format!("M{:.1} {:.1}h{s}v{s}h-{s}z", x - 4.0, y - 4.0, s = 8.0), "#fff"),
        8 => path(format!("M{x:.1} {:.1}l5 -8.5h-10z", y + 5.5), colour),
        _ => path(format!("M{:.1} {:.1}l8 8m0 -8l-8 8", x - 4.0, y - 4.0), "none"),
    }
}

fn put(svg: &mut String, element: std::fmt::Arguments) {
    writeln!(svg, "{element}").expect("strings take all");
}

fn text(svg: &mut String, [x, y]: [f64; 2], how: &str, words: &str) {
    put(svg, format_args!("<text x=\"{x:.1}\" y=\"{y:.1}\" {how}>{}</text>", escape(words)));
}

/// 0.001, 20, 1000: no needless digits.
fn tick(value: f64) -> String {
    let text = format!("{value:.9}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axis_holds_its_values_and_has_ticks_at_1_2_and_5() {
        let axis = Axis::around([0.03, 2.0, 0.0, f64::NAN, f64::INFINITY].into_iter(), [100.0, 0.0]);
        assert!(axis.holds(0.03) && axis.holds(2.0));
        let ticks: Vec<String> = axis.ticks().iter().map(|(value, _)| tick(*value)).collect();
        assert_eq!(ticks, ["0.05", "0.1", "0.2", "0.5", "1", "2"]);
        assert!((axis.place(axis.values[0]) - 100.0).abs() < 1e-9 && axis.place(axis.values[1]).abs() < 1e-9);
        // Four decades and more: powers of ten alone have their label.
        let wide = Axis::around([1e-3, 1e3].into_iter(), [0.0, 1.0]);
        let labels: Vec<String> = wide.ticks().iter().filter(|tick| tick.1).map(|(value, _)| tick(*value)).collect();
        assert_eq!(labels, ["0.001", "0.01", "0.1", "1", "10", "100", "1000"]);
        // Nothing to see is no panic.
        assert!(Axis::around(std::iter::empty(), [0.0, 1.0]).place(0.0).is_finite());
    }
}
