//! The scale of a plot, read off its frame and ticks as a person does: shares no code with what draws it.

use noctule::io::picture::Picture;

/// Whether a pixel is ink.
pub fn dark(picture: &Picture, x: i32, y: i32) -> bool {
    picture.pixel(x, y).is_some_and(|pixel| pixel.iter().all(|part| *part < 100))
}

/// Places of the first and the last tick of either axis, and the numbers that stand there.
pub struct Scale {
    across_px: [f64; 2],
    up_px: [f64; 2],
    across: [f64; 2],
    up: [f64; 2],
}

impl Scale {
    /// Finds the frame and its ticks: `across` and `up` are the first and the last number of the axes and how many there are.
    #[track_caller]
    pub fn read(picture: &Picture, across: ([f64; 2], usize), up: ([f64; 2], usize)) -> Self {
        let (width, height) = picture.size_px();
        let (width, height) = (width as i32, height as i32);
        let in_row = |y: i32| (0..width).filter(|x| dark(picture, *x, y)).count();
        let bottom = (0..height).rev().find(|y| in_row(*y) > 450).expect("the frame has a bottom");
        let in_column = |x: i32| (0..height).filter(|y| dark(picture, x, *y)).count();
        let left = (0..width).find(|x| in_column(*x) > 300).expect("the frame has a left side");
        // A number of one axis may stand beside the first tick of the other.
        let below: Vec<i32> = (left..width).filter(|x| dark(picture, *x, bottom + 4)).collect();
        let beside: Vec<i32> = (0..=bottom).rev().filter(|y| dark(picture, left - 4, *y)).collect();
        assert_eq!((below.len(), beside.len()), (across.1, up.1), "number of ticks");
        let ends = |places: &[i32]| [f64::from(places[0]), f64::from(places[places.len() - 1])];
        Self { across_px: ends(&below), up_px: ends(&beside), across: across.0, up: up.0 }
    }

    /// Pixel of a number of the lower and a number of the left axis.
    pub fn pixel(&self, across: f64, up: f64) -> (i32, i32) {
        let share = |value: f64, ends: [f64; 2]| (value - ends[0]) / (ends[1] - ends[0]);
        let at = |share: f64, ends: [f64; 2]| (ends[0] + share * (ends[1] - ends[0])).round() as i32;
        (at(share(across, self.across), self.across_px), at(share(up, self.up), self.up_px))
    }

    /// Colour at a number of the lower and a number of the left axis.
    #[track_caller]
    pub fn colour(&self, picture: &Picture, across: f64, up: f64) -> [u8; 3] {
        let (x, y) = self.pixel(across, up);
        picture.pixel(x, y).expect("on the picture")
    }
}
