//! Keys and their descriptions, from the comments of the structs that a file or an output has.

use std::collections::BTreeMap;
use std::path::Path;

use syn::{Attribute, Expr, Fields, Item, Lit, Meta, Type};

/// A key of a struct.
pub struct Key {
    pub name: String,
    /// Its type, without `Option`.
    pub kind: Type,
    /// First paragraph of its comment.
    pub about: String,
    /// Whether it may be left out.
    pub is_optional: bool,
}

/// The structs of some directories by their names; of several with one name, all.
pub struct Structs(BTreeMap<String, Vec<Struct>>);

/// A struct with named fields.
pub struct Struct {
    pub about: String,
    pub keys: Vec<Key>,
}

impl Structs {
    /// Of the sources below some directories of the repository.
    pub fn below(directories: &[&str]) -> Structs {
        let mut structs = Structs(BTreeMap::new());
        for directory in directories {
            structs.read(&Path::new(env!("CARGO_MANIFEST_DIR")).join(directory));
        }
        structs
    }

    fn read(&mut self, path: &Path) {
        if path.is_dir() {
            let entries = std::fs::read_dir(path).expect("a directory of sources");
            let mut paths: Vec<_> = entries.map(|entry| entry.expect("an entry").path()).collect();
            paths.sort();
            paths.iter().for_each(|path| self.read(path));
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            let text = std::fs::read_to_string(path).expect("a source");
            let file = syn::parse_file(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            file.items.iter().for_each(|item| self.keep(item));
        }
    }

    fn keep(&mut self, item: &Item) {
        let Item::Struct(item) = item else { return };
        let Fields::Named(fields) = &item.fields else { return };
        let all_have_defaults = serde(&item.attrs).iter().any(|word| word == "default");
        let mut keys = Vec::new();
        for field in &fields.named {
            let words = serde(&field.attrs);
            if words.iter().any(|word| word == "skip") {
                continue;
            }
            let rename =
                words.iter().find_map(|word| word.strip_prefix("rename=").map(str::to_owned));
            let (kind, is_option) = match inside(&field.ty, "Option") {
                Some(inner) => (inner, true),
                None => (field.ty.clone(), false),
            };
            let has_default = words.iter().any(|word| word.starts_with("default"));
            keys.push(Key {
                name: rename.unwrap_or_else(|| field.ident.as_ref().expect("named").to_string()),
                kind,
                about: comment(&field.attrs),
                is_optional: is_option || has_default || all_have_defaults,
            });
        }
        let found = Struct { about: comment(&item.attrs), keys };
        self.0.entry(item.ident.to_string()).or_default().push(found);
    }

    /// The struct of a name.
    pub fn named(&self, name: &str) -> Option<&Struct> {
        self.0.get(name).and_then(|all| all.first())
    }

    /// The comment of a key in an object with these keys: that of the struct which has all of them,
    /// and no others but some that may be left out. None where two such structs say different
    /// things.
    pub fn about(&self, key: &str, keys: &[&str]) -> Option<&str> {
        let fits = |one: &&Struct| {
            keys.iter().all(|key| one.keys.iter().any(|known| known.name == *key))
                && one.keys.iter().all(|k| k.is_optional || keys.contains(&k.name.as_str()))
        };
        let fitting: Vec<&Struct> = self.0.values().flatten().filter(fits).collect();
        let fewest = fitting.iter().map(|one| one.keys.len()).min()?;
        let closest = fitting.iter().filter(|one| one.keys.len() == fewest);
        let mut said = closest.filter_map(|one| one.keys.iter().find(|k| k.name == key));
        let first = said.next()?.about.as_str();
        (said.all(|other| other.about == first) && !first.is_empty()).then_some(first)
    }
}

/// What stands in `serde(...)`, word by word, values without quotes.
fn serde(attributes: &[Attribute]) -> Vec<String> {
    let of_serde = attributes.iter().filter(|attribute| attribute.path().is_ident("serde"));
    let lists = of_serde.filter_map(|attribute| match &attribute.meta {
        Meta::List(list) => Some(list.tokens.to_string()),
        _ => None,
    });
    lists
        .flat_map(|text| {
            let words = text.split(',').map(|word| word.replace([' ', '"'], ""));
            words.collect::<Vec<_>>()
        })
        .collect()
}

/// First paragraph of a comment, links as their words.
fn comment(attributes: &[Attribute]) -> String {
    let lines = attributes.iter().filter(|attribute| attribute.path().is_ident("doc"));
    let lines = lines.filter_map(|attribute| match &attribute.meta {
        Meta::NameValue(meta) => match &meta.value {
            Expr::Lit(literal) => match &literal.lit {
                Lit::Str(text) => Some(text.value().trim().to_owned()),
                _ => None,
            },
            _ => None,
        },
        _ => None,
    });
    let paragraph: Vec<String> = lines.take_while(|line| !line.is_empty()).collect();
    let text = paragraph.join(" ").replace("[`", "`").replace("`]", "`");
    text.replace("`super::", "`").replace("`None`", "nothing")
}

/// The first type within `outer<...>`, where a type is one.
pub fn inside(kind: &Type, outer: &str) -> Option<Type> {
    let Type::Path(path) = kind else { return None };
    let last = path.path.segments.last().filter(|last| last.ident == outer)?;
    let syn::PathArguments::AngleBracketed(arguments) = &last.arguments else { return None };
    arguments.args.iter().rev().find_map(|argument| match argument {
        syn::GenericArgument::Type(inner) => Some(inner.clone()),
        _ => None,
    })
}

/// Last word of the path of a type.
pub fn name_of(kind: &Type) -> String {
    match kind {
        Type::Path(path) => {
            path.path.segments.last().map_or_else(String::new, |s| s.ident.to_string())
        }
        Type::Array(array) => name_of(&array.elem),
        Type::Reference(reference) => name_of(&reference.elem),
        _ => String::new(),
    }
}
