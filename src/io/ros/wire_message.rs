//! Any type of our topics as a ROS message: a header, then its fields in their order and under their names.
//!
//! Schema and encoding come from the type's own table of fields, so a recording holds every bit that was on the topic and
//! nothing has to be kept in step by hand. The name loses dots and version: `noctule.Odometry.v1` is
//! `noctule_msgs/msg/Odometry`; `schema_hash` tells versions apart.

use super::standard::{HEADER_DEFINITION, Header, Octets};
use super::{Message, RosError};
use crate::io::wire::message::RawHeader;
use crate::io::wire::{Primitive, WireType};
use serde::de::{Deserialize, Deserializer, Error, SeqAccess, Visitor};
use serde::ser::{Serialize, SerializeTuple, Serializer};
use std::fmt::Write as _;
use std::marker::PhantomData;

/// A type of our topics with a header before it.
#[derive(Debug, Clone, PartialEq)]
pub struct WireMessage<T> {
    /// Time and frame, for ROS tools.
    pub header: Header,
    /// What was on the topic.
    pub wire: T,
}

/// A raw ping: header, the fields of [`RawHeader`], and the samples as they came, little-endian.
#[derive(Debug, Clone, PartialEq)]
pub struct RawPingMessage<'a> {
    /// Emission time, frame of the sensor.
    pub header: Header,
    /// Sequence, times, rate, format and counts.
    pub wire: RawHeader,
    /// `u32` PDM words, or `i16` or `f32` PCM as `[channel][sample]`.
    pub data: Octets<'a>,
}

impl<T: WireType> WireMessage<T> {
    /// The same, if this build wrote it.
    ///
    /// # Errors
    /// [`RosError::Layout`].
    pub fn checked(self) -> Result<Self, RosError> {
        check_layout(&self.wire).map(|()| self)
    }
}

impl RawPingMessage<'_> {
    /// The same, if this build wrote it.
    ///
    /// # Errors
    /// [`RosError::Layout`].
    pub fn checked(self) -> Result<Self, RosError> {
        check_layout(&self.wire).map(|()| self)
    }
}

fn check_layout<T: WireType>(wire: &T) -> Result<(), RosError> {
    if wire.schema_matches() {
        return Ok(());
    }
    Err(RosError::Layout { type_name: T::TYPE_NAME, found: wire.schema_hash_field(), allowed: T::SCHEMA_HASH })
}

fn ros_name(type_name: &str) -> String {
    let short = type_name.strip_prefix("noctule.").unwrap_or(type_name);
    format!("noctule_msgs/msg/{}", short.split('.').next().unwrap_or(short))
}

fn ros_primitive(primitive: Primitive) -> &'static str {
    match primitive {
        Primitive::U8 => "uint8",
        Primitive::U32 => "uint32",
        Primitive::U64 => "uint64",
        Primitive::I16 => "int16",
        Primitive::F32 => "float32",
        Primitive::F64 => "float64",
    }
}

fn definition<T: WireType>(tail: &str) -> String {
    let mut text = "std_msgs/Header header\n".to_owned();
    for field in T::FIELDS {
        let count = if field.count > 1 { format!("[{}]", field.count) } else { String::new() };
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{}{count} {}  # {}", ros_primitive(field.primitive), field.name, field.doc);
    }
    text + tail + HEADER_DEFINITION
}

impl<T: WireType> Message for WireMessage<T> {
    fn type_name() -> String {
        ros_name(T::TYPE_NAME)
    }

    fn schema() -> String {
        definition::<T>("")
    }
}

impl Message for RawPingMessage<'_> {
    fn type_name() -> String {
        "noctule_msgs/msg/RawPing".to_owned()
    }

    fn schema() -> String {
        definition::<RawHeader>("uint8[] data  # u32 PDM words, or i16 or f32 PCM [channel][sample], little-endian\n")
    }
}

fn value_count<T: WireType>() -> usize {
    T::FIELDS.iter().map(|field| field.count).sum()
}

/// Offset and type of every value, arrays taken apart: an array of fixed length is its values one after the other.
fn values<T: WireType>() -> impl Iterator<Item = (usize, Primitive)> {
    T::FIELDS.iter().flat_map(|field| {
        (0..field.count).map(|index| (field.offset + index * field.primitive.size(), field.primitive))
    })
}

fn at<const N: usize>(bytes: &[u8], offset: usize) -> [u8; N] {
    bytes.get(offset..).and_then(|rest| rest.first_chunk()).copied().unwrap_or([0; N])
}

fn put_values<T: WireType, S: SerializeTuple>(tuple: &mut S, wire: &T) -> Result<(), S::Error> {
    let bytes = bytemuck::bytes_of(wire);
    for (offset, primitive) in values::<T>() {
        match primitive {
            Primitive::U8 => tuple.serialize_element(&u8::from_ne_bytes(at(bytes, offset)))?,
            Primitive::I16 => tuple.serialize_element(&i16::from_ne_bytes(at(bytes, offset)))?,
            Primitive::U32 => tuple.serialize_element(&u32::from_ne_bytes(at(bytes, offset)))?,
            Primitive::U64 => tuple.serialize_element(&u64::from_ne_bytes(at(bytes, offset)))?,
            Primitive::F32 => tuple.serialize_element(&f32::from_ne_bytes(at(bytes, offset)))?,
            Primitive::F64 => tuple.serialize_element(&f64::from_ne_bytes(at(bytes, offset)))?,
        }
    }
    Ok(())
}

fn next<'de, A: SeqAccess<'de>, V: Deserialize<'de>>(sequence: &mut A) -> Result<V, A::Error> {
    sequence.next_element()?.ok_or_else(|| A::Error::custom("it ends early"))
}

fn take_values<'de, T: WireType, A: SeqAccess<'de>>(sequence: &mut A) -> Result<T, A::Error> {
    let mut wire: T = bytemuck::Zeroable::zeroed();
    let bytes = bytemuck::bytes_of_mut(&mut wire);
    for (offset, primitive) in values::<T>() {
        let place = &mut bytes[offset..offset + primitive.size()];
        match primitive {
            Primitive::U8 => place.copy_from_slice(&next::<_, u8>(sequence)?.to_ne_bytes()),
            Primitive::I16 => place.copy_from_slice(&next::<_, i16>(sequence)?.to_ne_bytes()),
            Primitive::U32 => place.copy_from_slice(&next::<_, u32>(sequence)?.to_ne_bytes()),
            Primitive::U64 => place.copy_from_slice(&next::<_, u64>(sequence)?.to_ne_bytes()),
            Primitive::F32 => place.copy_from_slice(&next::<_, f32>(sequence)?.to_ne_bytes()),
            Primitive::F64 => place.copy_from_slice(&next::<_, f64>(sequence)?.to_ne_bytes()),
        }
    }
    Ok(wire)
}

impl<T: WireType> Serialize for WireMessage<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(1 + value_count::<T>())?;
        tuple.serialize_element(&self.header)?;
        put_values(&mut tuple, &self.wire)?;
        tuple.end()
    }
}

impl<'de, T: WireType> Deserialize<'de> for WireMessage<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fields<T>(PhantomData<T>);
        impl<'de, T: WireType> Visitor<'de> for Fields<T> {
            type Value = WireMessage<T>;

            fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                formatter.write_str(T::TYPE_NAME)
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Self::Value, A::Error> {
                Ok(WireMessage { header: next(&mut sequence)?, wire: take_values(&mut sequence)? })
            }
        }
        deserializer.deserialize_tuple(1 + value_count::<T>(), Fields(PhantomData))
    }
}

impl Serialize for RawPingMessage<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(2 + value_count::<RawHeader>())?;
        tuple.serialize_element(&self.header)?;
        put_values(&mut tuple, &self.wire)?;
        tuple.serialize_element(&self.data)?;
        tuple.end()
    }
}

impl<'de: 'a, 'a> Deserialize<'de> for RawPingMessage<'a> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fields;
        impl<'de> Visitor<'de> for Fields {
            type Value = RawPingMessage<'de>;

            fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                formatter.write_str("a raw ping")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Self::Value, A::Error> {
                let header = next(&mut sequence)?;
                let wire = take_values(&mut sequence)?;
                Ok(RawPingMessage { header, wire, data: next(&mut sequence)? })
            }
        }
        deserializer.deserialize_tuple(2 + value_count::<RawHeader>(), Fields)
    }
}
