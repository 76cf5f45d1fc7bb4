//! The wire types as a C header, for clients in C and C++: `noctule topics --c-header`.
//!
//! In: the tables of fields that [`super::wire`]'s types carry. Out: one text with a struct, its names and its hash a type, and an
//! assertion for every offset, so that a compiler with other ideas of layout refuses it. Never lists a type by hand.

use super::topics::{Topic, layouts};
use super::wire::message::FLAG_EQUAL_DIRECTIONS;
use super::wire::{Field, Primitive};
use crate::signal::SampleFormat;
use std::fmt::Write as _;

/// `noctule.VelocityCommand.v1` becomes `noctule_velocity_command_v1`.
fn c_name(type_name: &str) -> String {
    let mut name = String::new();
    for (index, letter) in type_name.char_indices() {
        let starts_word = letter.is_ascii_uppercase() && !type_name[..index].ends_with('.');
        match letter {
            '.' => name.push('_'),
            _ if starts_word && index > 0 => name.extend(['_', letter.to_ascii_lowercase()]),
            _ => name.push(letter.to_ascii_lowercase()),
        }
    }
    name
}

fn c_type(primitive: Primitive) -> &'static str {
    match primitive {
        Primitive::U8 => "uint8_t",
        Primitive::U32 => "uint32_t",
        Primitive::U64 => "uint64_t",
        Primitive::I16 => "int16_t",
        Primitive::F32 => "float",
        Primitive::F64 => "double",
    }
}

fn write_struct(text: &mut String, type_name: &str, size: usize, hash: u64, fields: &[Field]) {
    let name = c_name(type_name);
    let _ = writeln!(text, "\n#define {}_TYPE_NAME \"{type_name}\"", name.to_uppercase());
    let _ = writeln!(text, "#define {}_SCHEMA_HASH UINT64_C(0x{hash:016x})", name.to_uppercase());
    let _ = writeln!(text, "struct {name} {{");
    for field in fields {
        let count = if field.count > 1 { format!("[{}]", field.count) } else { String::new() };
        let _ = writeln!(text, "    {} {}{count}; /* {} */", c_type(field.primitive), field.name, field.doc);
    }
    let _ = writeln!(text, "}};");
    let _ = writeln!(text, "NOCTULE_ASSERT(sizeof(struct {name}) == {size}, \"size of {type_name}\");");
    for field in fields {
        let offset = format!("offsetof(struct {name}, {}) == {}", field.name, field.offset);
        let _ = writeln!(text, "NOCTULE_ASSERT({offset}, \"{type_name}.{}\");", field.name);
    }
}

/// All wire types as a header for C11 and C++11.
#[must_use]
pub fn c_header() -> String {
    let mut text = String::from(
        "/* noctule's wire types. Made by `noctule topics --c-header`: do not edit.\n * SI units, radians; robot frame x forward, y left, \
         angles counter-clockwise; t_..._ns of CLOCK_BOOTTIME. */\n#ifndef NOCTULE_TYPES_H\n#define NOCTULE_TYPES_H\n\n\
         #include <stddef.h>\n#include <stdint.h>\n\n#ifdef __cplusplus\n#define NOCTULE_ASSERT(truth, what) static_assert(truth, what)\n\
         #else\n#define NOCTULE_ASSERT(truth, what) _Static_assert(truth, what)\n#endif\n",
    );
    let _ = writeln!(
        text,
        "\n/* Bit of an energyscape's flags: first direction and step tell all directions. */\n\
         #define NOCTULE_FLAG_EQUAL_DIRECTIONS {FLAG_EQUAL_DIRECTIONS}u"
    );
    for layout in layouts(&Topic::all(&["any".to_owned()], SampleFormat::Pdm)) {
        let hash = layout.schema_hash.unwrap_or(0);
        write_struct(&mut text, layout.type_name, layout.size, hash, layout.fields);
    }
    text.push_str("\n#endif\n");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_c() {
        assert_eq!(c_name("noctule.VelocityCommand.v1"), "noctule_velocity_command_v1");
        assert_eq!(c_name("noctule.Cues.v1"), "noctule_cues_v1");
    }
}
