//! Keys and their descriptions, from the comments of the structs that a file or an output has.

use std::collections::BTreeMap;
use std::path::Path;

use syn::{Attribute, Expr, Fields, FieldsNamed, Item, Lit, Meta, Type};

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

/// The structs of some directories by their names; of several with one name, all. A variant of an
/// enum with named fields counts as one, and as a key that an object has alone: so serde writes it.
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
        match item {
            Item::Struct(item) => {
                let Fields::Named(fields) = &item.fields else { return };
                let keys = keys(fields, serde(&item.attrs).iter().any(|word| word == "default"));
                let found = Struct { about: comment(&item.attrs), keys };
                self.0.entry(item.ident.to_string()).or_default().push(found);
            }
            Item::Enum(item) => {
                for variant in &item.variants {
                    let Fields::Named(fields) = &variant.fields else { continue };
                    let about = comment(&variant.attrs);
                    let outer = Key {
                        name: snake_case(&variant.ident.to_string()),
                        kind: Type::Verbatim(Default::default()),
                        about: about.clone(),
                        is_optional: false,
                    };
                    let inner = Struct { about: about.clone(), keys: keys(fields, false) };
                    let both = [Struct { about, keys: vec![outer] }, inner];
                    let name = format!("{}::{}", item.ident, variant.ident);
                    self.0.entry(name).or_default().extend(both);
                }
            }
            _ => {}
        }
    }

    /// The struct of a name.
    pub fn named(&self, name: &str) -> Option<&Struct> {
        self.0.get(name).and_then(|all| all.first())
    }

    /// The comment of a key in an object with these keys: that of the struct which has all of them,
    /// and no others but some that may be left out. None where two such structs say different
    /// things.
    pub fn about(&self, key: &str, keys: &[&str]) -> Option<&str> {
        let has_all = |one: &&Struct| keys.iter().all(|key| one.key(key).is_some());
        let fitting = self.0.values().flatten().filter(has_all).filter(|one| one.is_within(keys));
        let fitting: Vec<&Struct> = fitting.collect();
        let fewest = fitting.iter().map(|one| one.keys.len()).min()?;
        agreed(key, fitting.into_iter().filter(|one| one.keys.len() == fewest))
    }

    /// The same of an object that has more keys than the struct which was written into it.
    pub fn about_of_part(&self, key: &str, keys: &[&str]) -> Option<&str> {
        let has_it = |one: &&Struct| one.keys.len() > 1 && one.key(key).is_some();
        let fitting = self.0.values().flatten().filter(has_it).filter(|one| one.is_within(keys));
        let fitting: Vec<&Struct> = fitting.collect();
        let common = |one: &Struct| keys.iter().filter(|key| one.key(key).is_some()).count();
        let most = fitting.iter().map(|one| common(one)).max()?;
        agreed(key, fitting.into_iter().filter(|one| common(one) == most))
    }
}

impl Struct {
    fn key(&self, name: &str) -> Option<&Key> {
        self.keys.iter().find(|key| key.name == name)
    }

    /// Whether an object with these keys has all that the struct always has.
    fn is_within(&self, keys: &[&str]) -> bool {
        self.keys.iter().all(|key| key.is_optional || keys.contains(&key.name.as_str()))
    }
}

/// What all of them say of a key, if it is the same.
fn agreed<'s>(key: &str, structs: impl Iterator<Item = &'s Struct>) -> Option<&'s str> {
    let mut said = structs.filter_map(|one| one.key(key)).map(|key| key.about.as_str());
    let first = said.next()?;
    (said.all(|other| other == first) && !first.is_empty()).then_some(first)
}

/// As `rename_all = "snake_case"` writes the name of a variant.
fn snake_case(name: &str) -> String {
    let mut snake = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !snake.is_empty() {
            snake.push('_');
        }
        snake.extend(letter.to_lowercase());
    }
    snake
}

/// The keys of named fields.
fn keys(fields: &FieldsNamed, all_have_defaults: bool) -> Vec<Key> {
    let mut keys = Vec::new();
    for field in &fields.named {
        let words = serde(&field.attrs);
        if words.iter().any(|word| word == "skip" || word == "flatten") {
            continue;
        }
        let rename = words.iter().find_map(|word| word.strip_prefix("rename=").map(str::to_owned));
        let (kind, is_option) = match inside(&field.ty, "Option") {
            Some(inner) => (inner, true),
            None => (field.ty.clone(), false),
        };
        let has_default = words
            .iter()
            .any(|word| word.starts_with("default") || word.starts_with("skip_serializing_if"));
        keys.push(Key {
            name: rename.unwrap_or_else(|| field.ident.as_ref().expect("named").to_string()),
            kind,
            about: comment(&field.attrs),
            is_optional: is_option || has_default || all_have_defaults,
        });
    }
    keys
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
