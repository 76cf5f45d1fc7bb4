//! What lies in shared memory: `#[repr(C)]` types without hidden padding, each with its table of fields, its schema hash
//! and its name, all made by one macro from one list. `noctule topics`, `noctule echo`, the README's tables and the test
//! that holds Rust, C and Python together read that list.
//!
//! The only file of `io` where `unsafe` may stand (the transport's marker trait and its last resort). Never interprets
//! what it carries: [`message`] turns nouns of [`crate::signal`] into these types and back.

pub mod detections;
pub mod message;
pub mod motion;
pub mod points;
pub mod telemetry;

use iceoryx2::prelude::{MessagingPattern, Node, ServiceName, ipc_threadsafe};
use serde_json::{Map, Value, json};

/// Version that headers carry; a change of any layout changes the `.v1` of its name instead.
pub const HEADER_VERSION: u32 = 1;
/// Says "none" where a sensor index stands.
pub const NO_SENSOR: u32 = u32::MAX;

/// Type of a field, or of a slice's elements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Primitive {
    /// 8 bits, unsigned.
    U8,
    /// 32 bits, unsigned.
    U32,
    /// 64 bits, unsigned.
    U64,
    /// 16 bits, signed.
    I16,
    /// IEEE 754 single.
    F32,
    /// IEEE 754 double.
    F64,
}

impl Primitive {
    /// The name, as in Rust.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Primitive::U8 => "u8",
            Primitive::U32 => "u32",
            Primitive::U64 => "u64",
            Primitive::I16 => "i16",
            Primitive::F32 => "f32",
            Primitive::F64 => "f64",
        }
    }

    /// Size and alignment in bytes.
    #[must_use]
    pub const fn size(self) -> usize {
        match self {
            Primitive::U8 => 1,
            Primitive::I16 => 2,
            Primitive::U32 | Primitive::F32 => 4,
            Primitive::U64 | Primitive::F64 => 8,
        }
    }

    /// The value at the beginning of `bytes` as JSON; null when too short or not finite.
    fn read(self, bytes: &[u8]) -> Value {
        fn first<const N: usize>(bytes: &[u8]) -> [u8; N] {
            bytes.first_chunk().copied().unwrap_or([0; N])
        }
        match self {
            Primitive::U8 => json!(u8::from_ne_bytes(first(bytes))),
            Primitive::U32 => json!(u32::from_ne_bytes(first(bytes))),
            Primitive::U64 => json!(u64::from_ne_bytes(first(bytes))),
            Primitive::I16 => json!(i16::from_ne_bytes(first(bytes))),
            Primitive::F32 => json!(f32::from_ne_bytes(first(bytes))),
            Primitive::F64 => json!(f64::from_ne_bytes(first(bytes))),
        }
    }
}

/// A Rust type that can stand in a wire type: a primitive or an array of one.
pub trait WireField {
    /// Type of the element.
    const PRIMITIVE: Primitive;
    /// Number of elements.
    const COUNT: usize;
}

macro_rules! wire_field {
    ($($rust:ty => $primitive:ident),+) => { $(
        impl WireField for $rust {
            const PRIMITIVE: Primitive = Primitive::$primitive;
            const COUNT: usize = 1;
        }
    )+ };
}
wire_field!(u8 => U8, u32 => U32, u64 => U64, i16 => I16, f32 => F32, f64 => F64);

impl<T: WireField, const N: usize> WireField for [T; N] {
    const PRIMITIVE: Primitive = T::PRIMITIVE;
    const COUNT: usize = N * T::COUNT;
}

/// One field of a wire type.
#[derive(Debug, Clone, Copy)]
pub struct Field {
    /// Name, with its unit.
    pub name: &'static str,
    /// Offset in bytes.
    pub offset: usize,
    /// Type of the element.
    pub primitive: Primitive,
    /// Number of elements; more than one is an array.
    pub count: usize,
    /// Names of the values, for fields that are enumerations.
    pub value_name: Option<fn(u32) -> Option<&'static str>>,
    /// What it means, one line.
    pub doc: &'static str,
}

/// A type that lies in shared memory.
pub trait WireType: bytemuck::Pod + Default {
    /// Name under which every language knows it.
    const TYPE_NAME: &'static str;
    /// Every byte belongs to one of these, in order.
    const FIELDS: &'static [Field];
    /// FNV-1a (64 bit) of `<type name>|<field>@<offset>:<type>*<count>;...`. In every sample and in the service's attributes.
    const SCHEMA_HASH: u64 = schema_hash(Self::TYPE_NAME, Self::FIELDS);

    /// The hash that this sample says it was written with.
    fn schema_hash_field(&self) -> u64;

    /// Whether the writer's layout was ours.
    fn schema_matches(&self) -> bool {
        self.schema_hash_field() == Self::SCHEMA_HASH
    }
}

/// A wire type whose last field is a checksum of all bytes before it.
pub trait Checked: WireType {
    /// Offset of the checksum.
    const CHECKSUM_OFFSET: usize;

    /// The checksum that the sample carries.
    fn checksum_field(&self) -> u32;

    /// CRC-32 (IEEE) of the bytes before the checksum.
    fn compute_checksum(&self) -> u32 {
        let bytes = bytemuck::bytes_of(self);
        crc32fast::hash(&bytes[..Self::CHECKSUM_OFFSET])
    }

    /// Whether no byte was changed.
    fn checksum_matches(&self) -> bool {
        self.compute_checksum() == self.checksum_field()
    }
}

const fn fnv_byte(hash: u64, byte: u8) -> u64 {
    (hash ^ byte as u64).wrapping_mul(0x0000_0100_0000_01b3)
}

const fn fnv_text(mut hash: u64, text: &str) -> u64 {
    let bytes = text.as_bytes();
    let mut index = 0;
    while index < bytes.len() {
        hash = fnv_byte(hash, bytes[index]);
        index += 1;
    }
    hash
}

const fn fnv_decimal(hash: u64, number: usize) -> u64 {
    let hash = if number >= 10 { fnv_decimal(hash, number / 10) } else { hash };
    fnv_byte(hash, b'0' + (number % 10) as u8)
}

/// See [`WireType::SCHEMA_HASH`].
pub(crate) const fn schema_hash(type_name: &str, fields: &[Field]) -> u64 {
    let mut hash = fnv_byte(fnv_text(0xcbf2_9ce4_8422_2325, type_name), b'|');
    let mut index = 0;
    while index < fields.len() {
        let field = &fields[index];
        hash = fnv_byte(fnv_text(hash, field.name), b'@');
        hash = fnv_byte(fnv_decimal(hash, field.offset), b':');
        hash = fnv_byte(fnv_text(hash, field.primitive.name()), b'*');
        hash = fnv_byte(fnv_decimal(hash, field.count), b';');
        index += 1;
    }
    hash
}

/// Defines a wire type from its list of fields: the struct, its table and its hash. The first field must be `schema_hash`.
/// `name: type as Enum` says that the numbers are those of `Enum`.
macro_rules! wire_type {
    (
        $(#[doc = $type_doc:literal])+
        $type:ident = $type_name:literal {
            $( $(#[doc = $doc:literal])+ $name:ident: $field:ty $(as $names:path)?, )+
        }
    ) => {
        $(#[doc = $type_doc])+
        #[repr(C)]
        #[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable, iceoryx2::prelude::ZeroCopySend)]
        #[type_name($type_name)]
        pub struct $type { $( $(#[doc = $doc])+ pub $name: $field, )+ }

        impl $crate::io::wire::WireType for $type {
            const TYPE_NAME: &'static str = $type_name;
            const FIELDS: &'static [$crate::io::wire::Field] = &[$( $crate::io::wire::Field {
                name: stringify!($name),
                offset: std::mem::offset_of!($type, $name),
                primitive: <$field as $crate::io::wire::WireField>::PRIMITIVE,
                count: <$field as $crate::io::wire::WireField>::COUNT,
                value_name: $crate::io::wire::optional_names!($($names)?),
                doc: concat!($($doc,)+).trim_ascii(),
            }, )+];

            fn schema_hash_field(&self) -> u64 {
                self.schema_hash
            }
        }

        impl Default for $type {
            fn default() -> Self {
                Self::blank()
            }
        }

        impl $type {
            /// All zeros, but for the schema hash.
            #[must_use]
            pub fn blank() -> Self {
                Self { schema_hash: <Self as $crate::io::wire::WireType>::SCHEMA_HASH, ..bytemuck::Zeroable::zeroed() }
            }
        }
    };
}
pub(crate) use wire_type;

/// The option behind `as Enum` in [`wire_type`].
macro_rules! optional_names {
    () => {
        None
    };
    ($names:path) => {
        Some($names)
    };
}
pub(crate) use optional_names;

/// Text in an array of bytes, up to the first zero.
pub(crate) fn text_of(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes.split(|byte| *byte == 0).next().unwrap_or(&[])).into_owned()
}

/// The fields of `bytes` as a JSON object; enumerations by name, arrays as arrays, arrays of bytes as text, NaN and
/// infinities as null.
#[must_use]
pub fn fields_json(fields: &[Field], bytes: &[u8]) -> Map<String, Value> {
    let value = |field: &Field, index: usize| {
        let at = field.offset + index * field.primitive.size();
        let value = field.primitive.read(bytes.get(at..).unwrap_or(&[]));
        let number = value.as_u64().and_then(|number| u32::try_from(number).ok());
        match (field.value_name, number) {
            (Some(name), Some(number)) => name(number).map_or(value, Value::from),
            _ => value,
        }
    };
    fields
        .iter()
        .map(|field| {
            let value = match field.count {
                1 => value(field, 0),
                count if field.primitive == Primitive::U8 => {
                    text_of(bytes.get(field.offset..field.offset + count).unwrap_or(&[])).into()
                }
                count => (0..count).map(|index| value(field, index)).collect(),
            };
            (field.name.to_owned(), value)
        })
        .collect()
}

/// Removes what is left of a service that nobody can open any more. True if something was removed.
///
/// To be called only while holding the root's lock for set-up, after opening failed and no live node was found: then no
/// other process uses the service, which is what the transport asks for.
pub(super) fn force_remove_service(node: &Node<ipc_threadsafe::Service>, name: &ServiceName) -> bool {
    // SAFETY: the caller found the service unusable and without a live user; see above.
    unsafe { node.force_remove_service(name, MessagingPattern::PublishSubscribe) }.unwrap_or(false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use iceoryx2::prelude::ZeroCopySend;

    wire_type! {
        /// Two fields.
        Sample = "noctule.test.Sample.v1" {
            /// Layout of the writer.
            schema_hash: u64,
            /// First.
            first_m: f64,
            /// Numbers.
            numbers: [u32; 2] as name,
        }
    }

    fn name(number: u32) -> Option<&'static str> {
        (number == 7).then_some("seven")
    }

    #[test]
    fn the_hash_is_that_of_the_text_it_is_documented_to_be() {
        let text = "noctule.test.Sample.v1|schema_hash@0:u64*1;first_m@8:f64*1;numbers@16:u32*2;";
        let expected = text
            .bytes()
            .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3));
        assert_eq!(Sample::SCHEMA_HASH, expected);
        assert!(Sample::blank().schema_matches());
    }

    #[test]
    fn fields_come_out_as_json_with_names_and_without_nan() {
        let sample = Sample { first_m: f64::NAN, numbers: [7, 8], ..Sample::blank() };
        let object = fields_json(Sample::FIELDS, bytemuck::bytes_of(&sample));
        assert_eq!(object["first_m"], Value::Null);
        assert_eq!(object["numbers"], json!(["seven", 8]));
        assert_eq!(object["schema_hash"], json!(Sample::SCHEMA_HASH));
    }
}
