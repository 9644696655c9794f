//! The segment as a dissector for Wireshark, in Lua: named fields for every control message and every content.
//!
//! Frames of CAN carry no mark of their protocol. So the dissector offers itself for every extended data frame, and
//! takes those whose etag is one of the protocol's or of the segment's channels; the priority and the sender may be
//! any. Where a broker gives the etags, it learns them from the broker's frames. Messages longer than a frame are put
//! together as their subscribers do; the last frame has the fields of the whole.

use super::control::{CONTROL, ControlField, Shown};
use crate::cluster::Cluster;
use crate::contents::{ByteOrder, FieldLayout, FieldType, Layout};
use std::fmt::Write as _;

/// The text of the script.
pub fn render(cluster: &Cluster, source_name: &str) -> String {
    let mut out = String::new();
    // Writing into a string does not fail.
    let _ = write_all(&mut out, cluster, source_name);
    out
}

fn write_all(out: &mut String, cluster: &Cluster, source_name: &str) -> std::fmt::Result {
    writeln!(
        out,
        "-- Frames of the COSMIC segment {}, for Wireshark and tshark (-X lua_script:FILE).",
        cluster.name
    )?;
    writeln!(
        out,
        "-- Made by cosmic-plan of {}. Change that file, not this one.",
        source_name.replace(['\n', '\r'], " ")
    )?;
    out.push_str(HEAD);
    writeln!(out, "local nodes = {{")?;
    for node in cluster.nodes.iter().filter(|node| !node.asks) {
        writeln!(out, "    [{}] = \"{}\",", node.tx_node.get(), node.name)?;
    }
    writeln!(out, "}}\n")?;
    writeln!(out, "local control = {{}}")?;
    for message in CONTROL {
        writeln!(
            out,
            "control[{}] = {{ name = \"{}\", length = {}, fields = {{",
            message.etag.get(),
            message.name,
            message.len
        )?;
        for field in message.fields {
            write_control_field(out, message.name, field)?;
        }
        writeln!(out, "}} }}")?;
    }
    writeln!(out, "\nlocal contents = {{}}")?;
    for layout in &cluster.contents {
        writeln!(out, "contents.{0} = {{ length = {1}, fields = {{", key(&layout.name), layout.len)?;
        for field in &layout.fields {
            for position in 0..field.values() {
                write_field(out, layout, field, position)?;
            }
        }
        writeln!(out, "}} }}")?;
    }
    writeln!(out, "\nlocal channels = {{")?;
    for channel in &cluster.channels {
        let content = match cluster.layout_of(channel) {
            Some(layout) => format!("contents.{}", key(&layout.name)),
            None => "nil".to_owned(),
        };
        let etag = channel.etag.map_or("nil".to_owned(), |etag| etag.get().to_string());
        let class = channel.class.abbreviation();
        writeln!(
            out,
            "    {{ name = \"{}\", subject = \"{:016x}\", etag = {etag}, class = \"{class}\", length = {}, content = {content} }},",
            channel.name, channel.subject, channel.length
        )?;
    }
    writeln!(out, "}}\n")?;
    out.push_str(TAIL);
    Ok(())
}

fn write_control_field(out: &mut String, message: &str, field: &ControlField) -> std::fmt::Result {
    let abbreviation = format!("cosmic.{message}.{}", field.name);
    let mut more = String::new();
    let (proto, unit) = match field.shown {
        Shown::Hexadecimal if field.bits > 32 => {
            more += ", hexadecimal = true";
            (format!("ProtoField.uint64(\"{abbreviation}\", \"{}\", base.HEX)", field.name), "")
        }
        Shown::Hexadecimal => {
            more += ", hexadecimal = true";
            (format!("ProtoField.uint32(\"{abbreviation}\", \"{}\", base.HEX)", field.name), "")
        }
        Shown::Decimal(unit) if field.bits > 32 => {
            (format!("ProtoField.uint64(\"{abbreviation}\", \"{}\")", field.name), unit)
        }
        Shown::Decimal(unit) => (format!("ProtoField.uint32(\"{abbreviation}\", \"{}\")", field.name), unit),
        Shown::Names(names) => {
            let names: Vec<String> =
                names.iter().map(|(value, name)| format!("[{value}] = \"{name}\"")).collect();
            let names = names.join(", ");
            more += &format!(", names = {{ {names} }}");
            let proto =
                format!("ProtoField.uint32(\"{abbreviation}\", \"{}\", base.DEC, {{ {names} }})", field.name);
            (proto, "")
        }
    };
    writeln!(
        out,
        "    {{ name = \"{}\", proto = {proto}, at = {}, width = {}, kind = \"unsigned\", unit = \"{unit}\"{more} }},",
        field.name, field.at, field.bits
    )
}

fn write_field(out: &mut String, layout: &Layout, field: &FieldLayout, position: usize) -> std::fmt::Result {
    let name = field.count.map_or(field.name.clone(), |_| format!("{}_{position}", field.name));
    let abbreviation = format!("cosmic.{}.{name}", layout.name);
    let wide = field.kind.bits() > 32;
    let (proto, kind) = match field.kind {
        FieldType::Bool | FieldType::Bit => ("bool", "boolean"),
        FieldType::Single => ("float", "single"),
        FieldType::Double => ("double", "double"),
        _ if field.scaling.is_some() => ("double", "scaled"),
        FieldType::Unsigned(_) => (if wide { "uint64" } else { "uint32" }, "unsigned"),
        FieldType::Signed(_) => (if wide { "int64" } else { "int32" }, "signed"),
    };
    let labels = if field.labels.is_empty() || wide {
        String::new()
    } else {
        let labels: Vec<String> =
            field.labels.iter().map(|label| format!("[{}] = \"{}\"", label.raw, label.name)).collect();
        format!(", base.DEC, {{ {} }}", labels.join(", "))
    };
    let little = if layout.order == ByteOrder::Little { ", little = true" } else { "" };
    let signed = if matches!(field.kind, FieldType::Signed(_)) { ", signed = true" } else { "" };
    write!(
        out,
        "    {{ name = \"{name}\", proto = ProtoField.{proto}(\"{abbreviation}\", \"{name}\"{labels}), at = {}, width = {}, kind = \"{kind}\"{signed}{little}, unit = {}",
        field.bit_of(position),
        field.kind.bits(),
        text(field.unit.as_deref().unwrap_or(""))
    )?;
    if let Some(scaling) = field.scaling {
        write!(
            out,
            ", factor = {}, offset = {}, divisor = {}",
            scaling.factor,
            scaling.offset,
            10_i128.pow(scaling.exponent)
        )?;
    }
    if field.kind == FieldType::Bool {
        write!(out, ", least = 0, greatest = 1")?;
    } else if let (Some((least, greatest)), true) = (field.range, field.kind.is_float()) {
        write!(out, ", least = {:?}, greatest = {:?}", least.as_f64(), greatest.as_f64())?;
    } else if field.has_raw_range() {
        write!(out, ", least = {}, greatest = {}", field.raw_range.0, field.raw_range.1)?;
    }
    if !field.labels.is_empty() {
        let names: Vec<String> =
            field.labels.iter().map(|label| format!("[{}] = \"{}\"", label.raw, label.name)).collect();
        write!(out, ", named = {{ {} }}", names.join(", "))?;
    }
    writeln!(out, " }},")
}

/// A name that is no word of Lua.
fn key(name: &str) -> String {
    const WORDS: [&str; 10] =
        ["and", "elseif", "end", "function", "goto", "local", "nil", "not", "or", "repeat"];
    const MORE: [&str; 2] = ["then", "until"];
    if WORDS.contains(&name) || MORE.contains(&name) { format!("{name}_") } else { name.to_owned() }
}

/// As Lua writes text.
fn text(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\"").replace(['\n', '\r'], " "))
}

const HEAD: &str = r#"
local cosmic = Proto("cosmic", "COSMIC")
local f = {
    priority = ProtoField.uint8("cosmic.priority", "Priority"),
    tx_node = ProtoField.uint8("cosmic.tx_node", "TxNode"),
    publisher = ProtoField.string("cosmic.publisher", "Sender"),
    etag = ProtoField.uint16("cosmic.etag", "Etag"),
    message = ProtoField.string("cosmic.message", "Message"),
    channel = ProtoField.string("cosmic.channel", "Channel"),
    class = ProtoField.string("cosmic.class", "Class"),
    subject = ProtoField.string("cosmic.subject", "Subject"),
    stage = ProtoField.uint8("cosmic.configuration_request.stage", "stage"),
    nibble = ProtoField.uint8("cosmic.configuration_request.nibble", "part of the UID", base.HEX),
    data = ProtoField.bytes("cosmic.data", "Data"),
    part = ProtoField.string("cosmic.part", "Part of a message"),
}
local malformed = ProtoExpert.new("cosmic.malformed", "Not as described", expert.group.MALFORMED, expert.severity.WARN)
cosmic.experts = { malformed }

local can_id = Field.new("can.id")
local can_extended = Field.new("can.flags.xtd")
local can_remote = Field.new("can.flags.rtr")

"#;

const TAIL: &str = r#"-- What Wireshark is to know of the fields.
local all = {}
for _, field in pairs(f) do all[#all + 1] = field end
for _, described in ipairs({ control, contents }) do
    for _, message in pairs(described) do
        for _, field in ipairs(message.fields) do all[#all + 1] = field.proto end
    end
end
cosmic.fields = all

local by_subject, by_etag, halves = {}, {}, {}
-- Messages of several frames: what has come of each sender's, and the whole ones by the number of their last frame.
local begun, whole = {}, {}
for _, channel in ipairs(channels) do by_subject[channel.subject] = channel end

function cosmic.init()
    by_etag, halves, begun, whole = {}, {}, {}, {}
    for _, channel in ipairs(channels) do
        if channel.etag then by_etag[channel.etag] = channel end
    end
end

-- The frames of the broker say which etag a subject has.
local function learn(buffer)
    if buffer:len() ~= 8 then return end
    local answer, etag = buffer(1, 1):uint(), buffer(2, 2):uint()
    local half = tostring(buffer(4, 4):bytes()):lower()
    if answer == 0 or answer == 4 then
        halves[etag] = half
    elseif (answer == 1 or answer == 5) and halves[etag] then
        local channel = by_subject[halves[etag] .. half]
        if channel and not channel.etag then by_etag[etag] = channel end
        halves[etag] = nil
    end
end

local function xor(one, other)
    local result, weight = 0, 1
    while one > 0 or other > 0 do
        if one % 2 ~= other % 2 then result = result + weight end
        one, other, weight = math.floor(one / 2), math.floor(other / 2), 2 * weight
    end
    return result
end

-- 0 over a message with its CRC behind it.
local function crc_of(bytes)
    local crc = 65535
    for at = 0, bytes:len() - 1 do
        crc = xor(crc, 256 * bytes:get_index(at))
        for _ = 1, 8 do
            local carry = crc >= 32768
            crc = 2 * crc % 65536
            if carry then crc = xor(crc, 4129) end
        end
    end
    return crc
end

-- Takes a frame of a message, and keeps the whole when it is the last.
local function collect(buffer, key, frame_number, header)
    local piece = buffer:len() > 1 and buffer(1):bytes() or ByteArray.new()
    local message = begun[key]
    if header.first then
        message = { number = header.message, bytes = ByteArray.new(), next = 0 }
        begun[key] = message
    end
    if not message or message.number ~= header.message then return end
    -- The sender repeats a frame that some node has rejected.
    if header.frame == (message.next - 1) % 16 and tostring(piece) == message.last then return end
    if header.frame ~= message.next then
        begun[key] = nil
        return
    end
    message.bytes:append(piece)
    message.next, message.last = (message.next + 1) % 16, tostring(piece)
    if not header.last then return end
    begun[key] = nil
    local bytes = message.bytes
    if header.first then
        whole[frame_number] = bytes
    elseif bytes:len() >= 2 and crc_of(bytes) == 0 then
        whole[frame_number] = bytes:subset(0, bytes:len() - 2)
    end
end

-- The bits of a field, as UInt64.
local function bits_of(buffer, field)
    local first = math.floor(field.at / 8)
    local last = math.floor((field.at + field.width - 1) / 8)
    local range = buffer(first, last - first + 1)
    local shift
    local number
    if field.little then
        number, shift = range:le_uint64(), field.at - 8 * first
    else
        number, shift = range:uint64(), 8 * (last + 1) - field.at - field.width
    end
    number = number:rshift(shift)
    if field.width < 64 then number = number:lshift(64 - field.width):rshift(64 - field.width) end
    return number, range
end

local function as_number(bits, field)
    local number = bits:tonumber()
    if field.signed and number >= 2 ^ (field.width - 1) then number = number - 2 ^ field.width end
    return number
end

local function value_of(bits, range, field)
    if field.kind == "boolean" then return bits:tonumber() ~= 0 end
    if field.kind == "single" or field.kind == "double" then
        -- By way of the bytes: the field may stand anywhere.
        local hex = bits:tohex()
        local tvb = ByteArray.new(hex:sub(17 - field.width / 4)):tvb("value")
        return tvb(0):float()
    end
    if field.kind == "scaled" then
        return (as_number(bits, field) * field.factor + field.offset) / field.divisor
    end
    if field.width <= 32 then return as_number(bits, field) end
    if not field.signed then return bits end
    local spare = 64 - field.width
    local wide = bits:lshift(spare)
    return Int64.new(wide:lower(), wide:higher()):arshift(spare)
end

-- What the list of frames shows of a field. An item has no text of its own there.
local function text_of(field, bits, value, number)
    local names = field.named or field.names
    local text
    if names and names[number] then
        text = names[number] .. string.format(" (%.0f)", number)
    elseif field.hexadecimal then
        text = "0x" .. bits:tohex():sub(17 - math.ceil(field.width / 4))
    elseif field.kind == "boolean" then
        text = value and "True" or "False"
    elseif field.kind == "single" then
        text = string.format("%.7g", value)
    elseif field.kind == "double" or field.kind == "scaled" then
        text = string.format("%.15g", value)
    elseif field.width <= 32 then
        text = string.format("%.0f", value)
    else
        text = tostring(value)
    end
    if field.unit ~= "" then text = text .. " " .. field.unit end
    return field.name .. ": " .. text
end

local function add_fields(buffer, tree, fields, summary)
    for _, field in ipairs(fields) do
        local bits, range = bits_of(buffer, field)
        local value = value_of(bits, range, field)
        local item = tree:add(field.proto, range, value)
        if field.unit ~= "" then item:append_text(" " .. field.unit) end
        local number = (field.kind == "single" or field.kind == "double") and value or as_number(bits, field)
        local inside = not field.least or (number >= field.least and number <= field.greatest)
        if not inside then item:add_proto_expert_info(malformed, "outside the range that is described") end
        if field.named and not field.named[number] then
            item:add_proto_expert_info(malformed, "a value without a name")
        end
        if summary then summary[#summary + 1] = text_of(field, bits, value, number) end
    end
end

local function add_content(buffer, tree, content, summary)
    if not content then
        if buffer:len() > 0 then tree:add(f.data, buffer()) end
    elseif buffer:len() == content.length then
        add_fields(buffer, tree, content.fields, summary)
    else
        if buffer:len() > 0 then tree:add(f.data, buffer()) end
        tree:add_proto_expert_info(malformed, buffer:len() .. " bytes instead of " .. content.length)
    end
end

-- A frame of a channel whose events are longer than a frame.
local function add_message(buffer, pinfo, tree, channel, key, summary)
    if buffer:len() == 0 then
        tree:add_proto_expert_info(malformed, "no header of a message")
        return
    end
    local byte = buffer(0, 1):uint()
    local header = {
        first = byte >= 128, last = byte % 128 >= 64, message = math.floor(byte / 16) % 4, frame = byte % 16,
    }
    if not pinfo.visited then collect(buffer, key, pinfo.number, header) end
    local ends = (header.first and ", the first" or "") .. (header.last and ", the last" or "")
    local part = "message " .. header.message .. ", frame " .. header.frame .. ends
    tree:add(f.part, buffer(0, 1), part)
    local bytes = whole[pinfo.number]
    if not header.last then
        summary[1] = part
        if buffer:len() > 1 then tree:add(f.data, buffer(1)) end
    elseif not bytes then
        summary[1] = part
        tree:add_proto_expert_info(malformed, "frames of this message are missing")
    elseif bytes:len() > 0 then
        add_content(bytes:tvb("Message of " .. channel.name), tree, channel.content, summary)
    end
end

local function dissect(buffer, pinfo, tree)
    local id, extended, remote = can_id(), can_extended(), can_remote()
    if not id or not extended or not extended.value or (remote and remote.value) then return false end
    -- Lua 5.2 of Wireshark has bit32; later ones have operators that earlier ones do not parse.
    local number = id.value % 2 ^ 29
    local etag = number % 2 ^ 14
    local tx_node = math.floor(number / 2 ^ 14) % 2 ^ 7
    local priority = math.floor(number / 2 ^ 21)
    local message, channel = control[etag], by_etag[etag]
    if etag == 4 and not pinfo.visited then learn(buffer) end
    if not message and not channel then return false end

    local length = buffer:len()
    pinfo.cols.protocol = "COSMIC"
    local top = tree:add(cosmic, buffer())
    top:add(f.priority, priority):set_generated()
    top:add(f.tx_node, tx_node):set_generated()
    top:add(f.publisher, tx_node == 127 and "broker" or nodes[tx_node] or ("TxNode " .. tx_node)):set_generated()
    top:add(f.etag, etag):set_generated()
    local summary = {}
    if message then
        top:add(f.message, message.name):set_generated()
        top:append_text(", " .. message.name)
        pinfo.cols.info = message.name
        if etag == 1 then
            -- Stage and nibble stand where other frames have the end of the priority and the sender.
            top:add(f.stage, math.floor(number / 2 ^ 18) % 16):set_generated()
            top:add(f.nibble, math.floor(number / 2 ^ 14) % 16):set_generated()
        end
        if length == message.length then
            if length > 0 then add_fields(buffer, top, message.fields, summary) end
        else
            top:add_proto_expert_info(malformed, length .. " bytes instead of " .. message.length)
        end
    else
        top:add(f.channel, channel.name):set_generated()
        top:add(f.class, channel.class):set_generated()
        top:add(f.subject, channel.subject):set_generated()
        top:append_text(", " .. channel.name)
        pinfo.cols.info = channel.name
        if channel.length > 8 then
            add_message(buffer, pinfo, top, channel, number % 2 ^ 21, summary)
        else
            add_content(buffer, top, channel.content, summary)
        end
    end
    if #summary > 0 then pinfo.cols.info:append(": " .. table.concat(summary, ", ")) end
    return true
end

cosmic:register_heuristic("can", dissect)
"#;
