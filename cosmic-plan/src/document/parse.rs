//! From text to a tree.

use super::{At, Kind, Log, Node, Problem};
use toml::de::{DeTable, DeValue};

pub(super) fn toml(text: &str, log: &Log) -> Node {
    let (table, errors) = DeTable::parse_recoverable(text);
    for error in errors {
        log.add(Problem {
            place: error.span(),
            field: "syntax".to_owned(),
            what: error.message().to_owned(),
            help: "see https://toml.io for the syntax of TOML".to_owned(),
        });
    }
    let place = table.span();
    Node { place, kind: toml_table(table.get_ref()) }
}

fn toml_table(table: &DeTable<'_>) -> Kind {
    let mut entries: Vec<_> = table
        .iter()
        .map(|(key, value)| {
            let key = At { value: key.get_ref().to_string(), place: key.span() };
            (key, Node { place: value.span(), kind: toml_value(value.get_ref()) })
        })
        .collect();
    entries.sort_by_key(|(key, _)| key.place.start);
    Kind::Table(entries)
}

fn toml_value(value: &DeValue<'_>) -> Kind {
    match value {
        DeValue::String(text) => Kind::Text(text.to_string()),
        DeValue::Integer(number) => Kind::Number(number.as_str().to_owned(), number.radix()),
        DeValue::Float(number) => Kind::Number(number.as_str().to_owned(), 10),
        DeValue::Boolean(value) => Kind::Boolean(*value),
        DeValue::Datetime(_) => Kind::Other("a date"),
        DeValue::Array(items) => Kind::Array(
            items.iter().map(|item| Node { place: item.span(), kind: toml_value(item.get_ref()) }).collect(),
        ),
        DeValue::Table(table) => toml_table(table),
    }
}

pub(super) fn json(text: &str, log: &Log) -> Node {
    let strict = jsonc_parser::ParseOptions { allow_comments: true, ..Default::default() };
    let parsed = jsonc_parser::parse_to_ast(text, &jsonc_parser::CollectOptions::default(), &strict);
    let problem = match parsed {
        Ok(result) => match result.value {
            Some(value) => return json_value(&value, log),
            None => ("the document is empty".to_owned(), None),
        },
        Err(error) => (error.kind().to_string(), Some(error.range().start..error.range().end)),
    };
    log.add(Problem {
        place: problem.1,
        field: "syntax".to_owned(),
        what: problem.0,
        help: "see https://www.json.org for the syntax of JSON".to_owned(),
    });
    Node { place: 0..0, kind: Kind::Table(Vec::new()) }
}

fn json_value(value: &jsonc_parser::ast::Value<'_>, log: &Log) -> Node {
    use jsonc_parser::ast::Value;
    use jsonc_parser::common::Ranged as _;
    let mut names = std::collections::HashSet::new();
    let kind = match value {
        Value::StringLit(text) => Kind::Text(text.value.to_string()),
        Value::NumberLit(number) => Kind::Number(number.value.to_owned(), 10),
        Value::BooleanLit(value) => Kind::Boolean(value.value),
        Value::NullKeyword(_) => Kind::Other("null"),
        Value::Array(array) => {
            Kind::Array(array.elements.iter().map(|element| json_value(element, log)).collect())
        }
        Value::Object(object) => Kind::Table(
            object
                .properties
                .iter()
                .map(|property| {
                    let place = property.name.range().start..property.name.range().end;
                    let name = property.name.as_str();
                    if !names.insert(name.to_owned()) {
                        log.add(Problem {
                            place: Some(place.clone()),
                            field: name.to_owned(),
                            what: "stands here a second time".to_owned(),
                            help: "keep one of the two".to_owned(),
                        });
                    }
                    (At { value: name.to_owned(), place }, json_value(&property.value, log))
                })
                .collect(),
        ),
    };
    Node { place: value.range().start..value.range().end, kind }
}
