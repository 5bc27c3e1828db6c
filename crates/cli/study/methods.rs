//! The methods of a study, by name.

use gdibl_baker::analyse::study::{GDIBL, PATH};
use gdibl_baker::radiance::blend::BlendRule;
use gdibl_baker::sampling::Sampler;
use serde::Serialize;

use crate::fault::Fault;

/// The blend rules at the powers that people use.
const RULES: [BlendRule; 5] = [
    BlendRule::Footprint(4.0),
    BlendRule::Distance(2.0),
    BlendRule::Angular(2.0),
    BlendRule::AngularSmooth(2.0),
    BlendRule::Nearest,
];

/// One way to bake.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Method {
    /// As `gdibl bake` does it.
    Gdibl,
    /// By another blend rule.
    Blend(BlendRule),
    GdiblUniform,
    /// The report's own: random directions, none toward what is bright.
    GdiblRandom,
    Path,
    PathUniform,
}

/// A method that would tell nothing.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    pub method: String,
    pub why: &'static str,
}

/// What decides whether a method tells something of its own.
#[derive(Debug, Clone, Copy)]
pub struct Circumstances {
    pub probes: usize,
    /// The bake's own rule and sampler.
    pub blend: BlendRule,
    pub sampler: Sampler,
    /// Something gives light that a path can find.
    pub light: bool,
}

impl Method {
    /// All of them.
    pub fn all() -> Vec<Method> {
        let rules = RULES.map(Method::Blend);
        let first = [Method::Gdibl];
        let rest = [Method::GdiblUniform, Method::GdiblRandom, Method::Path, Method::PathUniform];
        first.into_iter().chain(rules).chain(rest).collect()
    }

    /// The methods of these names; an unknown one is the caller's mistake.
    pub fn parse_all(names: &[String]) -> Result<Vec<Method>, Fault> {
        let parse = |name: &String| {
            let named = Method::all().into_iter().find(|method| method.name() == *name);
            // Any power will do.
            let rule = || name.strip_prefix("gdibl ")?.parse().ok().map(Method::Blend);
            named.or_else(rule).ok_or_else(|| {
                let all: Vec<String> = Method::all().iter().map(Method::name).collect();
                Fault::Usage(format!("--methods: no method is called '{name}'; there are {}", all.join(", ")))
            })
        };
        let mut methods: Vec<Method> = Vec::new();
        for method in names.iter().map(parse) {
            let method = method?;
            if methods.contains(&method) {
                return Err(Fault::Usage(format!("--methods: '{}' is there twice", method.name())));
            }
            methods.push(method);
        }
        Ok(methods)
    }

    pub fn name(&self) -> String {
        match self {
            Method::Gdibl => GDIBL.into(),
            Method::Blend(rule) => format!("{GDIBL} {rule}"),
            Method::GdiblUniform => format!("{GDIBL} without importance"),
            Method::GdiblRandom => format!("{GDIBL} random"),
            Method::Path => PATH.into(),
            Method::PathUniform => format!("{PATH} without importance"),
        }
    }

    /// For who reads the page.
    pub fn about(&self, circumstances: &Circumstances) -> String {
        let Circumstances { probes, blend, .. } = circumstances;
        match self {
            Method::Gdibl if *probes > 1 => format!("as gdibl bakes: probes share a point by {blend}"),
            Method::Gdibl => "as gdibl bakes".into(),
            Method::Blend(rule) => format!("probes share a point by {rule} instead of {blend}"),
            Method::GdiblUniform => "no directions toward what is bright, uniform ones alone".into(),
            Method::GdiblRandom => "random uniform directions, as in the GDIBL report".into(),
            Method::Path => "path tracing with the same care: every bounce is traced, no probe is used".into(),
            Method::PathUniform => {
                "path tracing whose first directions are uniform; at surfaces it still asks what is bright".into()
            }
        }
    }

    /// Why it would repeat another one, or tell nothing.
    pub fn redundant(&self, circumstances: &Circumstances) -> Option<&'static str> {
        let Circumstances { probes, blend, sampler, light } = *circumstances;
        match self {
            Method::Blend(_) if probes < 2 => Some("with fewer than two probes nothing is blended"),
            Method::Blend(rule) if *rule == blend => Some("is what gdibl does here"),
            Method::GdiblRandom if sampler == Sampler::Random => Some("is gdibl without importance here"),
            Method::Path | Method::PathUniform if !light => Some("nothing in the level gives light to trace"),
            _ => None,
        }
    }

    pub fn importance(&self) -> bool {
        !matches!(self, Method::GdiblUniform | Method::GdiblRandom | Method::PathUniform)
    }
}

/// Those that tell something, and the others.
pub fn choose(methods: Vec<Method>, circumstances: &Circumstances) -> (Vec<Method>, Vec<LeftOut>) {
    let (mut kept, mut left_out) = (Vec::new(), Vec::new());
    for method in methods {
        match method.redundant(circumstances) {
            None => kept.push(method),
            Some(why) => left_out.push(LeftOut { method: method.name(), why }),
        }
    }
    (kept, left_out)
}

#[cfg(test)]
mod tests {
    use super::*;

    const OF_A_BOX: Circumstances =
        Circumstances { probes: 3, blend: BlendRule::Footprint(4.0), sampler: Sampler::Sobol, light: true };

    #[test]
    fn names_lead_back_to_methods_and_unknown_ones_list_them() {
        let names: Vec<String> = Method::all().iter().map(Method::name).collect();
        assert_eq!(Method::parse_all(&names).unwrap(), Method::all());
        let names = ["path".to_string(), "gdibl angular:7".into()];
        assert_eq!(Method::parse_all(&names).unwrap(), [Method::Path, Method::Blend(BlendRule::Angular(7.0))]);
        for wrong in ["gdible", "gdibl angular:x", "", "path nearest"] {
            let fault = Method::parse_all(&[wrong.into()]).unwrap_err();
            assert_eq!(fault.exit_code(), 2);
            let text = fault.to_string();
            for words in [wrong, "gdibl angular-smooth:2", "gdibl random", "path without importance"] {
                assert!(text.contains(words), "{words} in {text}");
            }
        }
        assert!(Method::parse_all(&["path".into(), "path".into()]).is_err());
    }

    #[test]
    fn methods_that_tell_nothing_are_left_out_and_said() {
        let names = |methods: &[Method]| methods.iter().map(Method::name).collect::<Vec<_>>().join(", ");
        let (kept, left_out) = choose(Method::all(), &OF_A_BOX);
        assert_eq!(
            names(&kept),
            "gdibl, gdibl distance:2, gdibl angular:2, gdibl angular-smooth:2, gdibl nearest, gdibl without importance, \
             gdibl random, path, path without importance"
        );
        assert_eq!(left_out, [LeftOut { method: "gdibl footprint:4".into(), why: "is what gdibl does here" }]);
        let bare = Circumstances { probes: 1, ..OF_A_BOX };
        let (kept, left_out) = choose(Method::all(), &bare);
        assert_eq!(names(&kept), "gdibl, gdibl without importance, gdibl random, path, path without importance");
        assert_eq!(left_out.len(), 5);
        let dark = Circumstances { light: false, sampler: Sampler::Random, blend: BlendRule::Nearest, ..OF_A_BOX };
        let (kept, _) = choose(Method::all(), &dark);
        assert_eq!(
            names(&kept),
            "gdibl, gdibl footprint:4, gdibl distance:2, gdibl angular:2, gdibl angular-smooth:2, gdibl without importance"
        );
    }
}
