//! Reads a shape: all keys first, whatever the shape, so that an error knows which key of which shape it is about.
//!
//! Goes in: a table with the key `shape`. Comes out: a [`Shape`] whose numbers nobody has judged yet. An error's text is
//! serde's own ("unknown field", "missing field") or that of a [`ParameterError`], whose key is relative to the table.

use super::Shape;
use crate::parameter::ParameterError;
use serde::de::{Deserialize, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use std::fmt;

#[derive(Debug, Clone, Copy, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    Rectangle,
    Circle,
    HalfCircle,
    Sector,
    Trapezoid,
    Polygon,
}

impl Kind {
    fn keys(self) -> &'static [&'static str] {
        match self {
            Kind::Rectangle => &["shape", "x_m", "y_m"],
            Kind::Circle => &["shape", "centre_m", "radius_m"],
            Kind::HalfCircle => &["shape", "centre_m", "radius_m", "heading_deg"],
            Kind::Sector => &["shape", "centre_m", "radius_m", "bearing_deg"],
            Kind::Trapezoid => &["shape", "x_m", "half_width_m"],
            Kind::Polygon => &["shape", "points_m"],
        }
    }
}

/// A number or a pair: `radius_m` is the one in a circle and the other in a sector.
enum Numbers {
    One(f64),
    Two([f64; 2]),
}

struct NumbersVisitor;

impl<'de> Visitor<'de> for NumbersVisitor {
    type Value = Numbers;

    fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str("a number or a pair of numbers")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Numbers, E> {
        Ok(Numbers::One(value))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Numbers, E> {
        Ok(Numbers::One(value as f64))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Numbers, A::Error> {
        let mut values = [0.0; 2];
        for (index, value) in values.iter_mut().enumerate() {
            *value = sequence.next_element()?.ok_or_else(|| A::Error::invalid_length(index, &self))?;
        }
        match sequence.next_element::<f64>()? {
            Some(_) => Err(A::Error::invalid_length(3, &self)),
            None => Ok(Numbers::Two(values)),
        }
    }
}

impl<'de> Deserialize<'de> for Numbers {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NumbersVisitor)
    }
}

/// Every key of every shape.
const KEYS: &[&str] =
    &["shape", "x_m", "y_m", "centre_m", "radius_m", "heading_deg", "bearing_deg", "half_width_m", "points_m"];

#[derive(Default)]
struct Fields {
    x_m: Option<[f64; 2]>,
    y_m: Option<[f64; 2]>,
    centre_m: Option<[f64; 2]>,
    radius_m: Option<Numbers>,
    heading_deg: Option<f64>,
    bearing_deg: Option<[f64; 2]>,
    half_width_m: Option<[f64; 2]>,
    points_m: Option<Vec<[f64; 2]>>,
}

impl Fields {
    fn radius<E: Error>(&self) -> Result<f64, E> {
        match &self.radius_m {
            Some(Numbers::One(radius_m)) => Ok(*radius_m),
            Some(Numbers::Two(pair)) => {
                Err(E::custom(ParameterError::new("radius_m", super::pair(pair), "a number: the radius")))
            }
            None => Err(E::missing_field("radius_m")),
        }
    }

    fn radii<E: Error>(&self) -> Result<[f64; 2], E> {
        match &self.radius_m {
            Some(Numbers::Two(radius_m)) => Ok(*radius_m),
            Some(Numbers::One(number)) => {
                Err(E::custom(ParameterError::new("radius_m", number, "a pair: [inner, outer] radius")))
            }
            None => Err(E::missing_field("radius_m")),
        }
    }
}

fn required<T, E: Error>(value: Option<T>, key: &'static str) -> Result<T, E> {
    value.ok_or_else(|| E::missing_field(key))
}

impl Fields {
    fn into_shape<E: Error>(self, kind: Kind) -> Result<Shape, E> {
        Ok(match kind {
            Kind::Rectangle => Shape::Rectangle { x_m: required(self.x_m, "x_m")?, y_m: required(self.y_m, "y_m")? },
            Kind::Circle => Shape::Circle { centre_m: required(self.centre_m, "centre_m")?, radius_m: self.radius()? },
            Kind::HalfCircle => Shape::HalfCircle {
                centre_m: required(self.centre_m, "centre_m")?,
                radius_m: self.radius()?,
                heading_deg: required(self.heading_deg, "heading_deg")?,
            },
            Kind::Sector => Shape::Sector {
                centre_m: required(self.centre_m, "centre_m")?,
                radius_m: self.radii()?,
                bearing_deg: required(self.bearing_deg, "bearing_deg")?,
            },
            Kind::Trapezoid => Shape::Trapezoid {
                x_m: required(self.x_m, "x_m")?,
                half_width_m: required(self.half_width_m, "half_width_m")?,
            },
            Kind::Polygon => Shape::Polygon { points_m: required(self.points_m, "points_m")? },
        })
    }
}

/// Reads all keys before it judges any, so that the allowed keys it names are those of the shape; and judges them while the
/// table is being read, so that an error gets the place of this table and not of the list around it.
struct ShapeVisitor;

impl<'de> Visitor<'de> for ShapeVisitor {
    type Value = Shape;

    fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str("a shape: { shape = \"circle\", ... }")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Shape, A::Error> {
        let (mut fields, mut kind, mut present) = (Fields::default(), None::<Kind>, Vec::new());
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "shape" => kind = Some(map.next_value()?),
                "x_m" => fields.x_m = Some(map.next_value()?),
                "y_m" => fields.y_m = Some(map.next_value()?),
                "centre_m" => fields.centre_m = Some(map.next_value()?),
                "radius_m" => fields.radius_m = Some(map.next_value()?),
                "heading_deg" => fields.heading_deg = Some(map.next_value()?),
                "bearing_deg" => fields.bearing_deg = Some(map.next_value()?),
                "half_width_m" => fields.half_width_m = Some(map.next_value()?),
                "points_m" => fields.points_m = Some(map.next_value()?),
                _ => drop(map.next_value::<IgnoredAny>()?),
            }
            present.push(key);
        }
        let keys = kind.map_or(KEYS, Kind::keys);
        if let Some(stray) = present.iter().find(|key| !keys.contains(&key.as_str())) {
            return Err(A::Error::unknown_field(stray, keys));
        }
        fields.into_shape(required(kind, "shape")?)
    }
}

impl<'de> Deserialize<'de> for Shape {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(ShapeVisitor)
    }
}
