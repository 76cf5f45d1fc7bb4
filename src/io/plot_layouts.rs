//! Pictures of sensor layouts beside one another: the robot from above, forward up, its sensors, what they see, and a bar of
//! how its drives ended. For people; nothing reads them back.
//!
//! In: cards, best first. Out: an RGB picture. Judges nothing: the order, the words and what is seen are the caller's.

use super::canvas::{INK, Picture, View};
use crate::geometry::Pose2;
use crate::sensor::dead_zone::{HOUSING_DEPTH_M, HOUSING_WIDTH_M};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{PrimitiveStyle, Rectangle};
use embedded_graphics::text::Alignment;
use nalgebra::Vector2;

const CARD_PX: i32 = 260;
const DRAWING_PX: i32 = 200;
const LINE_PX: i32 = 15;
const HEADING_PX: i32 = 46;
const COLUMNS: usize = 4;
const BAR_PX: i32 = 10;
/// Length of the arrows that say where sensors look, as a share of what is drawn.
const ARROW_SHARE: f64 = 0.16;

const FRAME: Rgb888 = Rgb888::new(200, 200, 200);
const BODY: Rgb888 = Rgb888::new(255, 255, 255);
const HOUSING: Rgb888 = Rgb888::new(20, 60, 110);
/// Seen by none, one, two, three sensors.
const SEEN: [Rgb888; 4] =
    [Rgb888::new(238, 238, 238), Rgb888::new(198, 222, 242), Rgb888::new(140, 186, 226), Rgb888::new(84, 146, 204)];
const AT_GOAL: Rgb888 = Rgb888::new(56, 142, 60);
const MISSED: Rgb888 = Rgb888::new(245, 166, 35);
const CONTACT: Rgb888 = Rgb888::new(200, 40, 40);

/// A layout to be drawn.
pub struct LayoutCard<'a> {
    /// Place and name.
    pub title: String,
    /// What is said below the drawing; three lines have room.
    pub lines: Vec<String>,
    /// Radius of the footprint.
    pub radius_m: f64,
    /// Where the sensors stand and look, robot frame.
    pub sensors: Vec<Pose2>,
    /// Number of sensors that see a point of the robot frame.
    pub seen_by: &'a dyn Fn(Vector2<f64>) -> usize,
    /// Runs at the goal, without it, and in contact.
    pub ended: [usize; 3],
}

/// Draws the cards in rows, the first at the top left.
#[must_use]
pub fn render_layouts(heading: &str, cards: &[LayoutCard]) -> Picture {
    let columns = cards.len().clamp(1, COLUMNS);
    let rows = cards.len().div_ceil(columns).max(1) as i32;
    let lines = cards.iter().map(|card| card.lines.len()).max().unwrap_or(0) as i32;
    let card_height_px = DRAWING_PX + (lines + 3) * LINE_PX + BAR_PX;
    // The heading and its legend need the width of two cards.
    let width_px = (columns.max(3) as i32) * CARD_PX;
    let mut picture = Picture::new(width_px as u32, (HEADING_PX + rows * card_height_px) as u32);
    picture.label(heading, Point::new(10, 18), Alignment::Left);
    legend(&mut picture);
    for (index, card) in cards.iter().enumerate() {
        let (row, column) = ((index / columns) as i32, (index % columns) as i32);
        draw_card(&mut picture, card, Point::new(column * CARD_PX, HEADING_PX + row * card_height_px));
    }
    picture
}

fn legend(picture: &mut Picture) {
    let mut x = 10;
    let words = [
        (AT_GOAL, "at the goal"),
        (MISSED, "missed"),
        (CONTACT, "contact"),
        (SEEN[0], "unseen"),
        (SEEN[1], "seen by 1"),
        (SEEN[2], "by 2"),
        (SEEN[3], "by 3"),
    ];
    for (colour, word) in words {
        fill(picture, Point::new(x, 28), Size::new(10, 10), colour);
        picture.label(word, Point::new(x + 15, 38), Alignment::Left);
        x += 15 + 7 * word.len() as i32 + 16;
    }
}

fn draw_card(picture: &mut Picture, card: &LayoutCard, corner: Point) {
    let margin_px = (CARD_PX - DRAWING_PX) / 2;
    picture.label(&card.title, corner + Point::new(margin_px, LINE_PX), Alignment::Left);
    let top_left = corner + Point::new(margin_px, LINE_PX + 6);
    let centre = top_left + Point::new(DRAWING_PX / 2, DRAWING_PX / 2);
    let view = View::robot(centre, 0.5 * f64::from(DRAWING_PX) / reach_m(card.radius_m));
    for y in top_left.y..top_left.y + DRAWING_PX {
        for x in top_left.x..top_left.x + DRAWING_PX {
            let seen = (card.seen_by)(view.point_m(x, y)).min(SEEN.len() - 1);
            picture.shape(Pixel(Point::new(x, y), SEEN[seen]));
        }
    }
    draw_robot(picture, card, &view);
    outline(picture, top_left, Size::new(DRAWING_PX as u32, DRAWING_PX as u32));
    let bar = top_left + Point::new(0, DRAWING_PX + 6);
    draw_bar(picture, bar, &card.ended);
    for (index, line) in card.lines.iter().enumerate() {
        let at = bar + Point::new(0, BAR_PX + LINE_PX * (index as i32 + 1));
        picture.label(line, at, Alignment::Left);
    }
}

fn draw_robot(picture: &mut Picture, card: &LayoutCard, view: &View) {
    let (centre, radius_px) = (view.place(Vector2::zeros()), card.radius_m * view.pixels_per_m());
    picture.disc(centre, radius_px, BODY);
    picture.ring(centre, radius_px, 1.5, INK);
    // An arrow ahead, since a disc has no front.
    let tip = Vector2::new(0.9 * card.radius_m, 0.0);
    for side in [-1.0, 1.0] {
        let wing = Vector2::new(0.65 * card.radius_m, side * 0.18 * card.radius_m);
        picture.stroke(view.place(wing), view.place(tip), 1.5, INK);
    }
    let (arrow_m, half_width_m) = (ARROW_SHARE * reach_m(card.radius_m), 0.5 * HOUSING_WIDTH_M);
    for pose in &card.sensors {
        let at = |x_m: f64, y_m: f64| view.place(pose.parent_from_local(Vector2::new(x_m, y_m)));
        let middle = at(-0.5 * HOUSING_DEPTH_M, 0.0);
        let reach = Vector2::repeat(HOUSING_WIDTH_M * view.pixels_per_m() + 1.0);
        picture.cover((middle - reach, middle + reach), HOUSING, |place| {
            let local_m = pose.local_from_parent(view.point_m(place.x as i32, place.y as i32));
            let inside_m = (local_m.x + HOUSING_DEPTH_M).min(-local_m.x).min(half_width_m - local_m.y.abs());
            inside_m * view.pixels_per_m() + 0.5
        });
        picture.stroke(at(0.0, 0.0), at(arrow_m, 0.0), 1.5, CONTACT);
        for side in [-0.25, 0.25] {
            picture.stroke(at(arrow_m, 0.0), at(0.7 * arrow_m, side * arrow_m), 1.5, CONTACT);
        }
    }
}

/// The robot and at least half a metre around it.
fn reach_m(radius_m: f64) -> f64 {
    1.6 * radius_m + 0.5
}

fn draw_bar(picture: &mut Picture, at: Point, ended: &[usize; 3]) {
    let total = ended.iter().sum::<usize>().max(1) as i32;
    let mut done = 0;
    for (count, colour) in ended.iter().zip([AT_GOAL, MISSED, CONTACT]) {
        let from = done * DRAWING_PX / total;
        done += *count as i32;
        let width = (done * DRAWING_PX / total - from) as u32;
        fill(picture, at + Point::new(from, 0), Size::new(width, BAR_PX as u32), colour);
    }
    outline(picture, at, Size::new(DRAWING_PX as u32, BAR_PX as u32));
}

fn fill(picture: &mut Picture, at: Point, size: Size, colour: Rgb888) {
    picture.shape(Rectangle::new(at, size).into_styled(PrimitiveStyle::with_fill(colour)));
}

fn outline(picture: &mut Picture, at: Point, size: Size) {
    picture.shape(Rectangle::new(at, size).into_styled(PrimitiveStyle::with_stroke(FRAME, 1)));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_seen_sensors_and_outcome_stand_where_they_belong() {
        // Only the left is seen, by two sensors; one of four runs ended in contact.
        let left = |point_m: Vector2<f64>| if point_m.y > 0.0 { 2 } else { 0 };
        let card = LayoutCard {
            title: "1. layout".into(),
            lines: vec!["words".into()],
            radius_m: 0.2,
            sensors: vec![Pose2 { x_m: 0.0, y_m: 0.1, heading_rad: std::f64::consts::FRAC_PI_2 }],
            seen_by: &left,
            ended: [3, 0, 1],
        };
        let picture = render_layouts("heading", &[card]);
        let (x0, y0) = (CARD_PX / 2, HEADING_PX + LINE_PX + 6 + DRAWING_PX / 2);
        let rgb = |colour: Rgb888| Some([colour.r(), colour.g(), colour.b()]);
        let pixels_per_m = 100.0 / (1.6 * 0.2 + 0.5);
        let px = |metres: f64| (metres * pixels_per_m).round() as i32;
        assert_eq!(picture.pixel(x0 - 90, y0), rgb(SEEN[2]), "left of the robot is left in the picture");
        assert_eq!(picture.pixel(x0 + 90, y0), rgb(SEEN[0]));
        assert_eq!(picture.pixel(x0 - px(0.08), y0 - 3), rgb(HOUSING), "the housing stands behind its front face");
        assert_eq!(picture.pixel(x0 + px(0.1), y0), rgb(BODY));
        let bar_y = y0 + DRAWING_PX / 2 + 6 + BAR_PX / 2;
        assert_eq!(picture.pixel(x0 - 90, bar_y), rgb(AT_GOAL));
        assert_eq!(picture.pixel(x0 + 90, bar_y), rgb(CONTACT));
    }
}
