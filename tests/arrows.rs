//! The source files of each crate import each other in no circle.
//!
//! An arrow goes from a file to every file whose items it names, in `use` or by path. A name that a module only re-exports
//! leads to the file that defines it. Declaring a module is no arrow, and re-exporting from a module below is none. Test
//! modules do not count. The test reads text, not types: it does not see methods.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet, VecDeque};
use std::path::{Path, PathBuf};

#[test]
fn source_files_import_each_other_in_no_circle() {
    let top = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text_of = |path: &Path| std::fs::read_to_string(top.join(path)).ok();
    let (mut files, mut circles) = (0, Vec::new());
    let folders = std::fs::read_dir(top.join("crates")).expect("the crates are in a folder");
    let names: BTreeSet<_> = folders.map(|folder| folder.expect("a readable folder").file_name()).collect();
    for name in names {
        let folder = Path::new("crates").join(name);
        let roots = ["src/lib.rs", "main.rs"].map(|root| folder.join(root));
        for root in roots.iter().filter(|root| top.join(root).is_file()) {
            let rooms = Rooms::read(root, &text_of);
            files += rooms.files.len();
            circles.extend(rooms.circles());
        }
    }
    assert!(files > 100, "only {files} files were found");
    assert!(circles.is_empty(), "{} circles of files that import each other:\n{}", circles.len(), circles.join("\n"));
}

/// Circles in files that are given as path and text; the first is the crate's root.
fn circles_of(files: &[(&str, &str)]) -> Vec<String> {
    let text_of =
        |path: &Path| files.iter().find(|(name, _)| Path::new(name) == path).map(|(_, text)| text.to_string());
    Rooms::read(Path::new(files[0].0), &text_of).circles()
}

#[test]
fn a_circle_of_files_is_found_through_reexports() {
    let circles = circles_of(&[
        ("lib.rs", "mod far;\npub mod near;\npub use near::Near;"),
        ("far.rs", "use crate::Near;\npub struct Far(Near);\nfn unused() -> &'static str { \"crate::nowhere::Here\" }"),
        ("near/mod.rs", "mod deep;\npub use deep::{Deep as Near};"),
        ("near/deep.rs", "pub struct Deep;\nfn far() { super::super::far::Far::new() }"),
    ]);
    assert_eq!(circles, ["far.rs -> near/deep.rs (crate::Near)\n  -> far.rs (super::super::far::Far::new)"]);
}

#[test]
fn a_parent_that_uses_what_it_reexports_has_an_arrow_to_it() {
    let child = ("child.rs", "use super::Parent;\npub struct Child(Parent);");
    assert!(circles_of(&[("lib.rs", "mod child;\npub use child::Child;\npub struct Parent;"), child]).is_empty());
    let circles = circles_of(&[("lib.rs", "mod child;\npub use child::Child;\npub struct Parent(Box<Child>);"), child]);
    assert_eq!(circles, ["lib.rs -> child.rs (child::Child)\n  -> lib.rs (super::Parent)"]);
}

#[test]
fn tests_and_comments_are_no_arrows() {
    let files = [
        ("lib.rs", "mod a;\nmod b;"),
        (
            "a.rs",
            "//! See [`crate::b::B`].\npub struct A;\n#[cfg(test)]\nmod tests { use crate::b::B; }\nfn own(_: char) {}",
        ),
        ("b.rs", "/* use crate::nothing; */ use crate::a::A;\npub struct B<'a>(&'a A);\nconst QUOTE: char = '\"';"),
    ];
    assert!(circles_of(&files).is_empty());
}

/// The source files of a crate, and which needs which.
struct Rooms {
    files: Vec<PathBuf>,
    modules: Vec<Module>,
}

/// A module: a file, or a part of one.
struct Module {
    file: usize,
    parent: Option<usize>,
    /// Nested modules by name.
    below: HashMap<String, usize>,
    /// Names that it defines.
    items: HashSet<String>,
    uses: Vec<Use>,
    /// Paths of two names and more outside of `use`.
    paths: Vec<Vec<String>>,
    /// All words outside of `use`.
    words: HashSet<String>,
}

/// One name of a `use` declaration; `*` stands for all names.
struct Use {
    path: Vec<String>,
    name: String,
    is_public: bool,
}

/// What a path leads to.
#[derive(Clone, Copy)]
enum Found {
    Module(usize),
    /// Something that this module defines.
    Item(usize),
}

impl Rooms {
    fn read(root: &Path, text_of: &dyn Fn(&Path) -> Option<String>) -> Rooms {
        let mut rooms = Rooms { files: Vec::new(), modules: Vec::new() };
        let text = text_of(root).unwrap_or_else(|| panic!("no file {}", root.display()));
        let folder = root.parent().expect("a file is in a folder");
        rooms.add_file(root, folder, &text, None, text_of);
        rooms
    }

    /// Reads a file and those of the modules below, which are in `folder`.
    fn add_file(
        &mut self,
        path: &Path,
        folder: &Path,
        text: &str,
        parent: Option<usize>,
        text_of: &dyn Fn(&Path) -> Option<String>,
    ) -> usize {
        let file = self.files.len();
        self.files.push(path.to_path_buf());
        let top = self.add_module(file, parent);
        let tokens = without_tests(tokens(text));
        // The modules that are open, with the depth of braces in each.
        let mut open = vec![(top, 0)];
        let mut at = 0;
        while at < tokens.len() {
            let word = |ahead: usize| tokens.get(at + ahead).map_or("", String::as_str);
            let &(module, depth) = open.last().expect("the file's own module stays open");
            // How many tokens belong together here.
            let mut length = 1;
            match (word(0), word(1), word(2)) {
                ("{", ..) => open.last_mut().expect("as above").1 += 1,
                ("}", ..) if depth == 0 => drop(open.pop()),
                ("}", ..) => open.last_mut().expect("as above").1 -= 1,
                ("mod", name, "{") => {
                    let below = self.add_module(file, Some(module));
                    self.modules[module].below.insert(name.to_string(), below);
                    open.push((below, 0));
                    length = 3;
                }
                ("mod", name, ";") => {
                    let folder = folder.join(name);
                    let places = [folder.with_extension("rs"), folder.join("mod.rs")];
                    let found = places.iter().find_map(|place| Some((place, text_of(place)?)));
                    let (place, text) = found.unwrap_or_else(|| panic!("{}: mod {name} has no file", path.display()));
                    let below = self.add_file(place, &folder, &text, Some(module), text_of);
                    self.modules[module].below.insert(name.to_string(), below);
                    length = 3;
                }
                ("use", next, _) if next != "<" => {
                    length = tokens[at..].iter().position(|token| token == ";").expect("`use` ends with a semicolon");
                    // After `pub` or `pub(…)`.
                    let is_public = at > 0 && ["pub", ")"].contains(&tokens[at - 1].as_str());
                    add_uses(&tokens[at + 1..at + length], &[], is_public, &mut self.modules[module].uses);
                }
                ("macro_rules", "!", name) => drop(self.modules[module].items.insert(name.to_string())),
                ("const" | "enum" | "fn" | "static" | "struct" | "trait" | "type" | "union", name, _) if depth == 0 => {
                    self.modules[module].items.insert(name.to_string());
                }
                (first, "::", _) if is_word(first) => {
                    let names = path_in(&tokens[at..]);
                    length = 2 * names.len() - 1;
                    self.modules[module].words.extend(names.iter().cloned());
                    self.modules[module].paths.push(names);
                }
                (other, ..) => drop(self.modules[module].words.insert(other.to_string())),
            }
            at += length;
        }
        top
    }

    fn add_module(&mut self, file: usize, parent: Option<usize>) -> usize {
        let (below, items, words) = Default::default();
        self.modules.push(Module { file, parent, below, items, uses: Vec::new(), paths: Vec::new(), words });
        self.modules.len() - 1
    }

    /// What a path in a module leads to; `None` out of the crate, or to nothing.
    fn find(&self, module: usize, path: &[String]) -> Option<Found> {
        self.find_within(module, path, self.modules.len())
    }

    /// `limit`: so many re-exports are followed.
    fn find_within(&self, module: usize, path: &[String], limit: usize) -> Option<Found> {
        let limit = limit.checked_sub(1)?;
        let mut found = Found::Module(module);
        for (place, name) in path.iter().enumerate() {
            let Found::Module(here) = found else { return Some(found) };
            let own = &self.modules[here];
            found = match name.as_str() {
                "self" => found,
                "crate" if place == 0 => Found::Module(0),
                "super" => Found::Module(own.parent?),
                name if own.below.contains_key(name) => Found::Module(own.below[name]),
                name if own.items.contains(name) => Found::Item(here),
                name => {
                    let known = own.uses.iter().filter(|known| known.name == name);
                    let all = own.uses.iter().filter(|known| known.name == "*");
                    let paths = known.map(|known| known.path.clone());
                    let mut paths = paths.chain(all.map(|all| [&all.path[..], &[name.to_string()]].concat()));
                    match paths.find_map(|path| self.find_within(here, &path, limit)) {
                        Some(found) => found,
                        // What a macro defines.
                        None if place > 0 && own.words.contains(name) => Found::Item(here),
                        None => return None,
                    }
                }
            };
        }
        Some(found)
    }

    /// The files that each file needs, and by what name.
    fn arrows(&self) -> BTreeMap<usize, BTreeMap<usize, String>> {
        let mut arrows: BTreeMap<usize, BTreeMap<usize, String>> = BTreeMap::new();
        for (here, module) in self.modules.iter().enumerate() {
            let mut add = |path: &[String], to: usize| {
                if self.modules[to].file != module.file {
                    let names = arrows.entry(module.file).or_default();
                    names.entry(self.modules[to].file).or_insert_with(|| path.join("::"));
                }
            };
            for Use { path, name, is_public } in &module.uses {
                match self.find_in_crate(here, path) {
                    Some(Found::Item(to)) if *is_public && self.is_below(to, here) && !module.words.contains(name) => {}
                    Some(Found::Item(to)) => add(path, to),
                    // All of its names.
                    Some(Found::Module(to)) if name == "*" => add(path, to),
                    // Paths say what is used of it.
                    Some(Found::Module(_)) | None => {}
                }
            }
            for path in &module.paths {
                if let Some(Found::Item(to)) = self.find_in_crate(here, path) {
                    add(path, to);
                }
            }
        }
        arrows
    }

    /// [`find`](Rooms::find) that knows that every path from `crate`, `self` or `super` leads somewhere.
    fn find_in_crate(&self, module: usize, path: &[String]) -> Option<Found> {
        let found = self.find(module, path);
        let is_own = ["crate", "self", "super"].contains(&path[0].as_str());
        let file = self.files[self.modules[module].file].display();
        assert!(found.is_some() || !is_own, "{file}: what does {} lead to?", path.join("::"));
        found
    }

    fn is_below(&self, mut module: usize, top: usize) -> bool {
        while let Some(parent) = self.modules[module].parent {
            if parent == top {
                return true;
            }
            module = parent;
        }
        false
    }

    /// The shortest circle through each file that is in one, each circle once.
    fn circles(&self) -> Vec<String> {
        let arrows = self.arrows();
        let next = |file: usize| arrows.get(&file).into_iter().flat_map(BTreeMap::keys).copied();
        let (mut told, mut circles) = (BTreeSet::new(), Vec::new());
        for start in 0..self.files.len() {
            // Breadth first, back to where it began.
            let (mut before, mut queue) = (HashMap::new(), VecDeque::from([start]));
            while let Some(file) = queue.pop_front() {
                for to in next(file) {
                    if let Entry::Vacant(entry) = before.entry(to) {
                        entry.insert(file);
                        queue.push_back(to);
                    }
                }
            }
            let Some(&last) = before.get(&start) else { continue };
            let mut circle = vec![start, last];
            while circle[circle.len() - 1] != start {
                circle.push(before[&circle[circle.len() - 1]]);
            }
            circle.reverse();
            if told.insert(circle.iter().copied().collect::<BTreeSet<usize>>()) {
                let name = |file: usize| self.files[file].display();
                let steps =
                    circle.windows(2).map(|pair| format!("-> {} ({})", name(pair[1]), arrows[&pair[0]][&pair[1]]));
                circles.push(format!("{} {}", name(start), steps.collect::<Vec<_>>().join("\n  ")));
            }
        }
        circles
    }
}

/// The names of the path that begins here: `a`, `b` and `c` of `a::b::c`.
fn path_in(tokens: &[String]) -> Vec<String> {
    let rest = tokens[1..].chunks(2).map_while(|pair| match pair {
        [colons, name] if colons == "::" && is_word(name) => Some(name),
        _ => None,
    });
    tokens[..1].iter().chain(rest).cloned().collect()
}

/// The names of a `use` declaration after `before`: `a::{b, c as d, e::*}`.
fn add_uses(tokens: &[String], before: &[String], is_public: bool, uses: &mut Vec<Use>) {
    let mut path = before.to_vec();
    let mut name = None;
    let mut at = 0;
    while at < tokens.len() {
        match tokens[at].as_str() {
            "::" => {}
            "as" => {
                name = Some(tokens[at + 1].clone());
                at += 1;
            }
            "{" => {
                let inner = &tokens[at + 1..tokens.len() - 1];
                let mut depth = 0;
                let parts = inner.split(|token| {
                    depth += i32::from(token == "{") - i32::from(token == "}");
                    token == "," && depth == 0
                });
                parts.filter(|part| !part.is_empty()).for_each(|part| add_uses(part, &path, is_public, uses));
                return;
            }
            "*" => name = Some("*".to_string()),
            other => path.push(other.to_string()),
        }
        at += 1;
    }
    if path.len() > 1 && path.last().is_some_and(|last| last == "self") {
        path.pop();
    }
    let name = name.or(path.last().cloned()).expect("`use` names something");
    uses.push(Use { path, name, is_public });
}

fn is_word(token: &str) -> bool {
    token.starts_with(|first: char| first.is_alphabetic() || first == '_')
}

/// Words, `::`, and other signs one by one; without comments, strings, characters and lifetimes.
fn tokens(text: &str) -> Vec<String> {
    let mut tokens = Vec::new();
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let until =
            |end: &str, from: usize| rest[from..].find(end).map_or(rest.len(), |place| from + place + end.len());
        let word = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        let mut ahead = rest.chars().skip(1);
        let skipped = if first.is_whitespace() {
            first.len_utf8()
        } else if rest.starts_with("//") {
            until("\n", 2)
        } else if rest.starts_with("/*") {
            until("*/", 2)
        } else if let Some(hashes) = raw_string(rest) {
            until(&format!("\"{}", "#".repeat(hashes)), word + hashes + 1)
        } else if first == '"' {
            end_of_quote(rest, '"')
        } else if first == '\'' {
            match (ahead.next(), ahead.next()) {
                (Some('\\'), _) | (_, Some('\'')) => end_of_quote(rest, '\''),
                // A lifetime, whose name is a word that nobody looks up.
                _ => 1,
            }
        } else {
            0
        };
        let length = match skipped {
            0 if word > 0 => word,
            0 if rest.starts_with("::") => 2,
            0 => first.len_utf8(),
            _ => skipped,
        };
        if skipped == 0 {
            tokens.push(rest[..length].to_string());
        }
        rest = &rest[length..];
    }
    tokens
}

/// How many `#` a raw string that begins here has.
fn raw_string(text: &str) -> Option<usize> {
    let text = text.strip_prefix('b').unwrap_or(text).strip_prefix('r')?;
    let hashes = text.find(|c| c != '#')?;
    text[hashes..].starts_with('"').then_some(hashes)
}

/// Bytes of what stands in quotes, with both of them.
fn end_of_quote(text: &str, quote: char) -> usize {
    let mut is_escaped = false;
    for (place, sign) in text.char_indices().skip(1) {
        if sign == quote && !is_escaped {
            return place + 1;
        }
        is_escaped = sign == '\\' && !is_escaped;
    }
    text.len()
}

/// Leaves out what `#[cfg(test)]` stands before.
fn without_tests(tokens: Vec<String>) -> Vec<String> {
    const MARK: [&str; 7] = ["#", "[", "cfg", "(", "test", ")", "]"];
    let mut kept = Vec::new();
    let mut at = 0;
    while at < tokens.len() {
        if !tokens[at..].iter().zip(MARK).all(|(token, mark)| token == mark) {
            kept.push(tokens[at].clone());
            at += 1;
            continue;
        }
        // An item ends with a semicolon or a brace that is closed, outside of all brackets.
        at += MARK.len();
        let mut depth = 0;
        while at < tokens.len() {
            let token = tokens[at].as_str();
            depth += i32::from("{[(".contains(token)) - i32::from("}])".contains(token));
            at += 1;
            if depth == 0 && (token == ";" || token == "}") {
                break;
            }
        }
    }
    kept
}
