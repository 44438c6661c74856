//! The house rules that a compiler does not check: floors, neighbours, and who may name what.
//!
//! The floors are read from `rust/lib.rs`, so that a new module has to be given one.

#![allow(clippy::unwrap_used)]

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

const MAX_LINES: usize = 600;
const STAGES: usize = 2;
const ROUTE: usize = 3;
/// The one edge between stages.
const STAGE_EDGE: (&str, &str) = ("coarse", "fitness");

struct File {
    /// Relative to `rust/`, with slashes.
    path: String,
    /// Top module: "coarse" for `coarse/robust.rs`, "lib" for `lib.rs`.
    module: String,
    text: String,
}

impl File {
    /// The lines that are code, with their numbers: no comments, no doc tests.
    fn code(&self) -> impl Iterator<Item = (usize, &str)> {
        let code = |line: &'_ str| !line.trim_start().starts_with("//");
        (1..)
            .zip(self.text.lines())
            .filter(move |(_, line)| code(line))
    }

    /// Where `word` stands on its own in the code.
    fn lines_with(&self, word: &str) -> Vec<String> {
        let is_word = |line: &str| {
            line.split(|c: char| !c.is_alphanumeric() && c != '_')
                .any(|part| part == word)
        };
        self.code()
            .filter(|(_, line)| is_word(line))
            .map(|(number, line)| format!("rust/{}:{number}: {}", self.path, line.trim()))
            .collect()
    }

    /// The top modules that are reached by `crate::name`.
    fn imports(&self) -> BTreeSet<String> {
        let text: String = self
            .code()
            .map(|(_, line)| line.to_owned() + "\n")
            .collect();
        let mut found = BTreeSet::new();
        for after in text.split("crate::").skip(1) {
            // `crate::{a, b::c}` names what stands in front of the first `::` of each.
            let names = match after.strip_prefix('{') {
                Some(list) => list.split('}').next().unwrap().split(',').collect(),
                None => vec![after],
            };
            for name in names {
                let ident = |c: &char| c.is_alphanumeric() || *c == '_';
                found.insert(name.trim().chars().take_while(ident).collect());
            }
        }
        found.remove(&self.module);
        found
    }
}

fn files() -> Vec<File> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("rust");
    let (mut files, mut folders) = (Vec::new(), vec![root.clone()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let relative = path.strip_prefix(&root).unwrap();
                let parts: Vec<&str> = relative.iter().map(|p| p.to_str().unwrap()).collect();
                files.push(File {
                    path: parts.join("/"),
                    module: parts[0].trim_end_matches(".rs").into(),
                    text: fs::read_to_string(&path).unwrap(),
                });
            }
        }
    }
    files.sort_by(|a, b| a.path.cmp(&b.path));
    assert!(files.len() > 30, "the sources were not found");
    files
}

/// The floor of every module, from the headings of `lib.rs`.
fn floors(files: &[File]) -> BTreeMap<String, usize> {
    let lib = files.iter().find(|file| file.path == "lib.rs").unwrap();
    let (mut floor, mut floors) = (None, BTreeMap::new());
    for line in lib.text.lines() {
        if let Some(heading) = line.strip_prefix("// Floor ") {
            floor = heading.split(':').next().unwrap().parse().ok();
        }
        let Some((before, name)) = line.split_once("mod ") else {
            continue;
        };
        if line.starts_with("//") || !(before.is_empty() || before.starts_with("pub")) {
            continue;
        }
        let name = name.trim_end_matches(';').to_owned();
        floors.insert(name, floor.expect("a module stands under a floor"));
    }
    assert_eq!(floors.get("error"), Some(&0));
    assert_eq!(floors.get("neighbors"), Some(&1));
    assert_eq!(floors.get("icp"), Some(&STAGES));
    assert_eq!(floors.get("pipeline"), Some(&ROUTE));
    floors
}

fn assert_none(rule: &str, breaches: &[String]) {
    assert!(breaches.is_empty(), "{rule}:\n{}", breaches.join("\n"));
}

/// Every (file, importing module, imported module) that comes down from one module to another.
fn edges(files: &[File]) -> Vec<(&File, String)> {
    files
        .iter()
        .filter(|file| file.module != "lib")
        .flat_map(|file| file.imports().into_iter().map(move |to| (file, to)))
        .collect()
}

#[test]
fn every_file_belongs_to_a_module_of_lib() {
    let files = files();
    let floors = floors(&files);
    let strays: Vec<String> = files
        .iter()
        .filter(|file| file.module != "lib" && !floors.contains_key(&file.module))
        .map(|file| file.path.clone())
        .collect();
    assert_none("lib.rs lists all modules", &strays);
}

#[test]
fn imports_go_down_only_and_stages_do_not_import_each_other() {
    let files = files();
    let floors = floors(&files);
    let mut breaches = Vec::new();
    for (file, to) in edges(&files) {
        // Names that lib.rs hands out, as `crate::Error`, stand on no floor.
        let Some(below) = floors.get(&to) else {
            continue;
        };
        let here = floors[&file.module];
        let allowed = match here {
            STAGES => *below < STAGES || (file.module.as_str(), to.as_str()) == STAGE_EDGE,
            _ => *below <= here,
        };
        if !allowed {
            breaches.push(format!(
                "rust/{} (floor {here}) imports {to} (floor {below})",
                file.path
            ));
        }
    }
    assert_none("imports go down", &breaches);
}

#[test]
fn nothing_knows_of_python_but_the_bindings() {
    let breaches: Vec<String> = edges(&files())
        .iter()
        .filter(|(_, to)| to == "python")
        .map(|(file, _)| format!("rust/{} imports python", file.path))
        .collect();
    assert_none("the crate works without Python", &breaches);
}

#[test]
fn modules_import_in_one_direction() {
    let files = files();
    let mut below: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
    for (file, to) in edges(&files) {
        below.entry(&file.module).or_default().insert(to);
    }
    // Take away what imports nothing that is left, until nothing is left.
    while !below.is_empty() {
        let left: BTreeSet<String> = below.keys().map(|name| (*name).to_owned()).collect();
        let before = below.len();
        below.retain(|_, imports| imports.iter().any(|name| left.contains(name)));
        assert!(below.len() < before, "a circle of imports among {left:?}");
    }
}

#[test]
fn the_optimisers_have_never_heard_of_a_cloud() {
    let geometry = [
        "cloud",
        "rigid",
        "neighbors",
        "surface_cloud",
        "distance_field",
        "Point",
    ];
    let breaches: Vec<String> = edges(&files())
        .iter()
        .filter(|(file, to)| file.module == "optim" && geometry.contains(&to.as_str()))
        .map(|(file, to)| format!("rust/{} imports {to}", file.path))
        .collect();
    assert_none("optim sees no cloud", &breaches);
}

#[test]
fn each_foreign_library_has_its_one_room() {
    for (library, room) in [
        ("rayon", "parallel.rs"),
        ("fearless_simd", "vectorize.rs"),
        ("kiddo", "neighbors/general.rs"),
        ("rand_pcg", "random.rs"),
        ("pyo3", "python/"),
        ("numpy", "python/"),
    ] {
        let files = files();
        let (inside, outside): (Vec<&File>, Vec<&File>) =
            files.iter().partition(|file| file.path.starts_with(room));
        assert!(
            inside
                .iter()
                .any(|file| !file.lines_with(library).is_empty()),
            "{library} is not named in {room}"
        );
        let named: Vec<String> = outside.iter().flat_map(|f| f.lines_with(library)).collect();
        assert_none(&format!("only rust/{room} names {library}"), &named);
    }
}

#[test]
fn nothing_prints_panics_by_hand_or_is_unsafe() {
    for word in [
        "unsafe",
        "println",
        "eprintln",
        "print",
        "eprint",
        "dbg",
        "todo",
        "unimplemented",
    ] {
        let used: Vec<String> = files().iter().flat_map(|f| f.lines_with(word)).collect();
        assert_none(&format!("no {word}"), &used);
    }
}

#[test]
fn files_can_be_read_in_one_sitting() {
    let long: Vec<String> = files()
        .iter()
        .map(|file| (file, file.text.lines().count()))
        .filter(|(_, n)| *n > MAX_LINES)
        .map(|(file, n)| format!("rust/{}: {n} lines", file.path))
        .collect();
    assert_none(&format!("at most {MAX_LINES} lines"), &long);
    let nameless: Vec<String> = files()
        .iter()
        .filter(|file| !file.text.starts_with("//! "))
        .map(|file| file.path.clone())
        .collect();
    assert_none("a file begins by saying what it is", &nameless);
}
