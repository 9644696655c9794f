//! Headers, modules, DBC files and dissectors do with bytes what the host does.

use crate::tools::{Program, find, run};
use crate::zoo::{compare, events, folder, grown_zoo, hex, read, vectors, zoo};
use cosmic_core::can::{Id, Priority};
use cosmic_plan::cluster::Cluster;
use cosmic_plan::contents::{FieldLayout, FieldType, Layout, Value};
use cosmic_plan::output::{c, dbc, html, python};
use cosmic_plan::plan::{Effort, plan};
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

pub(crate) fn file(folder: &Path, name: &str, content: impl AsRef<[u8]>) {
    std::fs::write(folder.join(name), content).expect("it can be written");
}

#[test]
fn c_does_what_the_host_does() {
    let Some(compiler) = find(&Program::C) else { return };
    let folder = folder("c");
    let cluster = read(&grown_zoo(30));
    let (questions, answers) = vectors(&cluster, 20, |_| true);
    file(&folder, "zoo.h", c::render(&cluster, "zoo.toml"));
    file(&folder, "input", questions);
    let mut program = String::from(
        "#include \"zoo.h\"\n#include <inttypes.h>\n#include <stdio.h>\n#include <stdlib.h>\n#include <string.h>\n\
         static void data(const uint8_t *bytes, unsigned length) {\n    \
         for (unsigned n = 0; n < length; n++) printf(\"%02x\", bytes[n]);\n}\n",
    );
    for layout in &cluster.contents {
        let name = &layout.name;
        write!(
            program,
            "static bool answer_{name}(const uint8_t *bytes, size_t length) {{\n    zoo_{name}_t event;\n    \
             uint8_t again[{}];\n    if (!zoo_{name}_decode(&event, bytes, length)) return false;\n    \
             if (!zoo_{name}_encode(&event, again)) return false;\n    data(again, {});\n",
            layout.len, layout.len
        )
        .unwrap();
        layout.fields.iter().for_each(|field| print_in_c(&mut program, field));
        program += "    return true;\n}\n";
    }
    program += "int main(void) {\n    char name[64], text[4096];\n    while (fgets(text, sizeof text, stdin)) {\n        \
                uint8_t bytes[2048]; unsigned length = 0;\n        text[strcspn(text, \"\\n\")] = 0;\n        \
                char *hex = strchr(text, ' ');\n        memcpy(name, text, (size_t)(hex - text)); name[hex - text] = 0;\n        \
                for (hex++; hex[0] && hex[1]; hex += 2) { char byte[3] = { hex[0], hex[1], 0 }; \
                bytes[length++] = (uint8_t)strtoul(byte, NULL, 16); }\n        printf(\"%s \", text);\n        bool well = false;\n";
    for layout in &cluster.contents {
        writeln!(
            program,
            "        if (!strcmp(name, \"{0}\")) well = answer_{0}(bytes, length);",
            layout.name
        )
        .unwrap();
    }
    program += "        printf(well ? \"\\n\" : \"malformed\\n\");\n    }\n    return 0;\n}\n";
    file(&folder, "main.c", program);
    let mut command = Command::new(compiler);
    command.args([
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Wconversion",
        "-pedantic",
        "-Werror",
        "-o",
        "main",
        "main.c",
    ]);
    run(command.current_dir(&folder));
    let input = std::fs::File::open(folder.join("input")).expect("it was written");
    compare(&run(Command::new(folder.join("main")).stdin(input)), &answers);
}

/// Prints the number of a field.
fn print_in_c(program: &mut String, field: &FieldLayout) {
    // A word of C has a line behind it.
    let name = if ["int", "class"].contains(&field.name.as_str()) {
        format!("{}_", field.name)
    } else {
        field.name.clone()
    };
    let one = |value: String| match field.kind {
        FieldType::Single => {
            format!("uint32_t bits; memcpy(&bits, &{value}, 4); printf(\"%\" PRIu32, bits);")
        }
        FieldType::Double => {
            format!("uint64_t bits; memcpy(&bits, &{value}, 8); printf(\"%\" PRIu64, bits);")
        }
        FieldType::Signed(_) => format!("printf(\"%\" PRId64, (int64_t){value});"),
        _ => format!("printf(\"%\" PRIu64, (uint64_t){value});"),
    };
    match field.count {
        None => writeln!(program, "    {{ printf(\" \"); {} }}", one(format!("event.{name}"))).unwrap(),
        Some(count) => writeln!(
            program,
            "    for (int n = 0; n < {count}; n++) {{ printf(n ? \",\" : \" \"); {} }}",
            one(format!("event.{name}[n]"))
        )
        .unwrap(),
    }
}

const PYTHON: &str = "
import dataclasses, decimal, enum, fractions, struct, sys
import zoo

def number(layout, name, value):
    # The number on the wire, by what encoding makes of the value alone.
    kind, factor, offset, places, width = KINDS[layout][name]
    if kind == 'real':
        return int.from_bytes(struct.pack('>f' if width == 32 else '>d', value), 'big')
    if kind == 'scaled':
        steps = (fractions.Fraction(value) * 10**places - offset) / factor
        return int(steps + fractions.Fraction(1, 2)) if steps >= 0 else -int(-steps + fractions.Fraction(1, 2))
    return int(value)

for line in sys.stdin:
    name, data = line.rstrip('\\n').split(' ')
    content = TYPES[name]
    try:
        event = content.decode(bytes.fromhex(data))
        again = event.encode()
    except zoo.Malformed:
        print(name, data, 'malformed')
        continue
    numbers = []
    for field in dataclasses.fields(event):
        value = getattr(event, field.name)
        if isinstance(value, tuple):
            numbers.append(','.join(str(number(name, field.name, one)) for one in value))
        else:
            numbers.append(str(number(name, field.name, value)))
    print(name, data, again.hex(), *numbers)
";

#[test]
fn python_does_what_the_host_does() {
    let Some(interpreter) = find(&Program::Python) else { return };
    let folder = folder("python");
    let cluster = read(&grown_zoo(30));
    // A float that is none changes its bits on the way through Python on some machines.
    let (questions, answers) = vectors(&cluster, 20, |_| true);
    let is_number = |line: &&str| !holds_none(&cluster, line);
    let questions: Vec<&str> = questions.lines().filter(is_number).collect();
    let answers: Vec<&str> = answers.lines().filter(is_number).collect();
    file(&folder, "zoo.py", python::render(&cluster, "zoo.toml"));
    file(&folder, "input", questions.join("\n"));
    let mut tables = String::from("TYPES, KINDS = {}, {}\n");
    for layout in &cluster.contents {
        writeln!(
            tables,
            "TYPES['{}'] = zoo.{}\nKINDS['{}'] = {{}}",
            layout.name,
            layout.type_name(),
            layout.name
        )
        .unwrap();
        for field in &layout.fields {
            let scaling = field.scaling_or_none();
            let kind = match field.kind {
                FieldType::Single | FieldType::Double => "real",
                _ if field.scaling.is_some() => "scaled",
                _ => "integer",
            };
            let name = if field.name == "class" { "class_" } else { &field.name };
            writeln!(
                tables,
                "KINDS['{}']['{name}'] = ('{kind}', {}, {}, {}, {})",
                layout.name,
                scaling.factor,
                scaling.offset,
                scaling.exponent,
                field.kind.bits()
            )
            .unwrap();
        }
    }
    let program = PYTHON.replace("import zoo\n", &format!("import zoo\n{tables}"));
    file(&folder, "main.py", program);
    let input = std::fs::File::open(folder.join("input")).expect("it was written");
    let printed = run(Command::new(interpreter).arg("main.py").current_dir(&folder).stdin(input));
    compare(&printed, &answers.join("\n"));
}

/// Returns whether a line of questions or answers has a float that is no number.
fn holds_none(cluster: &Cluster, line: &str) -> bool {
    let mut words = line.split(' ');
    let layout = cluster.contents.iter().find(|layout| Some(&*layout.name) == words.clone().next()).unwrap();
    let bytes = bytes_of(words.nth(1).unwrap_or(""));
    layout.decode(&bytes).is_ok_and(|fields| {
        fields.iter().any(|field| match field.value {
            Value::Single(value) => value.is_nan(),
            Value::Double(value) => value.is_nan(),
            _ => false,
        })
    })
}

fn bytes_of(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap()).collect()
}

#[test]
fn python_prints_events_and_refuses_what_does_not_fit() {
    let Some(interpreter) = find(&Program::Python) else { return };
    let folder = folder("session");
    let text = include_str!("../../examples/rover.toml");
    let brokered = text.replace("[segment]", "[segment]\nbinding = \"broker\"");
    file(&folder, "rover.py", python::render(&read(text), "rover.toml"));
    file(&folder, "brokered.py", python::render(&read(&brokered), "rover.toml"));
    let session = "
import rover, brokered
# The battery: priority 252, node 6.
etag = rover.CHANNELS['battery'].etag
event = rover.decode(252 << 21 | 6 << 14 | etag, bytes.fromhex('2ee0ff9c41a0'))
print(event.channel.name, event.publisher, event.priority, event.content)
print(event.content.UNITS['temperature'])
assert event.content.encode().hex() == '2ee0ff9c41a0'
# A soft event under any priority.
attitude = rover.CHANNELS['attitude'].etag
data = rover.Attitude(-1.5, 0.25, 90, 7, True).encode()
for priority in (1, 17, 249):
    event = rover.decode(priority << 21 | 4 << 14 | attitude, data)
    assert event.content == rover.Attitude(-1.5, 0.25, 90.0, 7, True), event
    assert rover.dbc_id(priority << 21 | 4 << 14 | attitude) == 1 << 21 | 4 << 14 | attitude
assert rover.decode(1 << 21 | 4 << 14 | 77, data) is None
for wrong in (rover.Attitude(0, 0, 400, 7, True), rover.Attitude(0, 0, 0, 11, True), rover.Gripper(9, 0), rover.Wheel(float('nan'), 0, True)):
    try:
        print(wrong.encode())
        raise SystemExit(f'{wrong} fits')
    except rover.Malformed as error:
        print(error)
# The broker says which etag the battery has.
assert brokered.decode(252 << 21 | 6 << 14 | 9000, bytes.fromhex('2ee0ff9c41a0')) is None
brokered.decode(0x1F5FC004, bytes.fromhex('2a002328b0a01c00'))
brokered.decode(0x1F5FC004, bytes.fromhex('2a01232800000007'))
print(brokered.decode(252 << 21 | 6 << 14 | 9000, bytes.fromhex('2ee0ff9c41a0')).content.voltage)
";
    file(&folder, "session.py", session);
    let printed = run(Command::new(interpreter)
        .arg("session.py")
        .current_dir(&folder)
        .env("PYTHONIOENCODING", "utf-8"));
    let expected = "battery power 252 Battery(voltage=12.0, current=-1.0, temperature=25.0, charge=80)\n°C\n\
                    yaw is 40000, outside -32768 to 32767 on the wire\nquality is 11, outside 0 to 10 on the wire\n\
                    state is 9, which has no name\ndistance is nan\n12.0\n";
    assert_eq!(printed.replace('\r', ""), expected);
}

const CANTOOLS: &str = "
import sys, cantools, rover
sys.stdin.reconfigure(encoding='utf-8')
one = cantools.database.load_file('rover.dbc')
every = cantools.database.load_file('rover_every.dbc')
masked = cantools.database.load_file('rover.dbc', frame_id_mask=0x3FFF, strict=False)
for line in sys.stdin:
    can_id, data, expected = line.rstrip('\\n').split(' ', 2)
    can_id, data = int(can_id, 16), bytes.fromhex(data)
    # By the whole identifier, in the file that lists them all.
    by_id = every.decode_message(can_id, data, decode_choices=True)
    # By the helper of the Python module, in the small file.
    by_helper = one.decode_message(rover.dbc_id(can_id), data)
    # By a mask over all but the etag, as `cantools decode -m 0x3FFF` does.
    by_mask = masked.get_message_by_frame_id(can_id).decode(data)
    assert by_id == by_helper == by_mask, (by_id, by_helper, by_mask)
    # By the Python module alone.
    event = rover.decode(can_id, data)
    for name, value in by_id.items():
        own = getattr(event.content, name)
        assert str(value) == own.name.lower() if hasattr(own, 'name') else abs(float(own) - float(value)) <= 1e-9 * abs(float(value)), (name, own, value)
    units = {signal.name: signal.unit for signal in one.get_message_by_name(event.channel.name).signals}
    assert all(units[name] == unit for name, unit in event.content.UNITS.items()), units
    print(can_id, len(by_id))
";

/// For every priority and every sender that the middleware may use for a channel.
#[test]
fn cantools_decodes_every_frame() {
    let Some(interpreter) = find(&Program::Cantools) else { return };
    let folder = folder("dbc");
    let cluster = read(include_str!("../../examples/rover.toml"));
    file(&folder, "rover.dbc", dbc::encode(&dbc::render(&cluster, dbc::Identifiers::One)));
    file(&folder, "rover_every.dbc", dbc::encode(&dbc::render(&cluster, dbc::Identifiers::Every)));
    file(&folder, "rover.py", python::render(&cluster, "rover.toml"));
    file(&folder, "main.py", CANTOOLS);
    let mut input = String::new();
    for (at, channel) in cluster.channels.iter().enumerate() {
        let Some(layout) = cluster.layout_of(channel).filter(|layout| layout.len <= 8) else { continue };
        for node in cluster.publishers(at) {
            for priority in priorities(&cluster, at) {
                for event in events(layout, 3).iter().filter(|event| layout.decode(event).is_ok()) {
                    if holds_none(&cluster, &format!("{} {}", layout.name, hex(event))) {
                        continue;
                    }
                    let id = Id::new(priority, node.tx_node, channel.etag.unwrap());
                    writeln!(input, "{:x} {} x", id.raw(), hex(event)).unwrap();
                }
            }
        }
    }
    let frames = input.lines().count();
    assert!(frames > 200, "{frames}");
    file(&folder, "input", input);
    let input = std::fs::File::open(folder.join("input")).expect("it was written");
    let printed = run(Command::new(interpreter).arg("main.py").current_dir(&folder).stdin(input));
    assert_eq!(printed.lines().count(), frames);
}

/// All priorities that frames of a channel may have on the bus: computed as the middleware does, at all instants from
/// publication to the deadline and beyond.
fn priorities(cluster: &Cluster, channel: usize) -> Vec<Priority> {
    use cosmic_plan::cluster::PlannedClass;
    match &cluster.channels[channel].class {
        PlannedClass::Hard { .. } => vec![Priority::HARD],
        PlannedClass::NonRealTime { importance } => vec![PlannedClass::priority_of(*importance)],
        PlannedClass::Soft => {
            let deadline = cluster.channels[channel].deadline.unwrap().as_ticks();
            let step = cluster.priority_step.as_ticks();
            let mut all: Vec<u8> =
                (0..=deadline).step_by(1000).map(|left| (1 + left / step).clamp(1, 249) as u8).collect();
            all.dedup();
            all.into_iter().map(Priority::new).collect()
        }
    }
}

/// As cantools has them: the bits where DBC says they are, for both byte orders, signs, scales, floats.
#[test]
fn cantools_reads_the_bits_that_the_host_reads() {
    let Some(interpreter) = find(&Program::Cantools) else { return };
    let folder = folder("dbc-bits");
    let text = grown_zoo(30);
    let cluster = read(&text);
    let short = |layout: &Layout| layout.len <= 8;
    file(&folder, "zoo.dbc", dbc::encode(&dbc::render(&cluster, dbc::Identifiers::One)));
    let mut input = String::new();
    for channel in &cluster.channels {
        let Some(layout) = cluster.layout_of(channel).filter(|layout| short(layout)) else { continue };
        for event in events(layout, 20) {
            let Ok(fields) = layout.decode(&event) else { continue };
            write!(input, "{} {}", channel.name, hex(&event)).unwrap();
            for field in fields {
                let values = match field.value {
                    Value::List(values) => values
                        .into_iter()
                        .enumerate()
                        .map(|(n, v)| (format!("{}_{n}", field.name), v))
                        .collect(),
                    value => vec![(field.name.to_owned(), value)],
                };
                for (name, value) in values {
                    let value = match value {
                        Value::Boolean(value) => u8::from(value).to_string(),
                        Value::Single(value) => f64::from(value).to_string(),
                        value => value.to_string(),
                    };
                    write!(input, " {name}={value}").unwrap();
                }
            }
            input += "\n";
        }
    }
    let lines = input.lines().count();
    assert!(lines > 200, "{lines}");
    file(&folder, "input", input);
    let program = "
import sys, math, cantools
zoo = cantools.database.load_file('zoo.dbc')
for line in sys.stdin:
    name, data, *fields = line.split()
    names = [message.name for message in zoo.messages]
    message = zoo.get_message_by_name(name if name in names else name + '_of_keeper')
    decoded = message.decode(bytes.fromhex(data))
    assert len(decoded) == len(fields), (decoded, fields)
    for field in fields:
        field, value = field.split('=')
        own = decoded[field]
        try:
            close = math.isclose(float(own), float(value), rel_tol=1e-9, abs_tol=1e-12) or math.isnan(float(own)) and math.isnan(float(value))
        except (TypeError, ValueError):
            close = str(own) == value
        assert close, (line, field, own, value)
    print(name)
";
    file(&folder, "main.py", program);
    let input = std::fs::File::open(folder.join("input")).expect("it was written");
    let printed = run(Command::new(interpreter).arg("main.py").current_dir(&folder).stdin(input));
    assert_eq!(printed.lines().count(), lines);
}

#[test]
fn a_page_shows_the_whole_cluster() {
    for text in [zoo(), include_str!("../../examples/rover.toml").to_owned()] {
        let cluster = read(&text);
        let plan = plan(&cluster, &Effort::default()).expect("it fits");
        let assessment = cosmic_plan::analysis::segment::assess(&cluster, &plan);
        let page = html::render(&cluster, &plan, &assessment, "zoo.toml");
        assert!(page.contains("</svg>") && page.ends_with("</html>\n"));
        // Nothing is loaded from elsewhere.
        assert!(!page.contains("src=") && !page.contains("href=\"http"));
        for layout in &cluster.contents {
            assert!(page.contains(&format!("id=\"content-{}\"", layout.name)));
            for field in &layout.fields {
                assert!(page.contains(&format!("id=\"field-{}-{}\"", layout.name, field.name)));
            }
        }
        for link in page.split("href=\"#").skip(1) {
            let id = link.split('"').next().unwrap();
            assert!(page.contains(&format!("id=\"{id}\"")), "{id} is nowhere");
        }
        // As many rows begin as end, and so on: it is well formed as XML but for the elements that HTML does not close.
        for element in ["table", "tr", "td", "th", "div", "svg", "g", "h2", "h3", "p", "code", "a"] {
            let begun =
                page.matches(&format!("<{element}>")).count() + page.matches(&format!("<{element} ")).count();
            let closed = page.matches(&format!("</{element}>")).count();
            let alone = page.matches(&format!("<{element}/>")).count();
            assert_eq!(begun, closed + alone, "{element}");
        }
    }
}
