//! What the example measures and commands: simple shapes in place of sensors, which a bare board has not.
//!
//! Each is a function of the number of the measurement, so that two runs are alike.

/// The speed of the wheel, in millimetres per second: up and down between 5 and 25 m/s.
pub fn wheel_speed(sequence: u32) -> u16 {
    5_000 + triangle(sequence, 2_000) * 10
}

/// The temperature of the brake disc, in hundredths of a degree Celsius: between 80 and 280 degrees.
pub fn disc_temperature(sequence: u32) -> i16 {
    8_000 + triangle(sequence, 2_000).cast_signed() * 10
}

/// Travel of the suspension in tenths of a millimetre, and its velocity in millimetres per second.
pub fn suspension(sequence: u32) -> (i16, i16) {
    let travel = triangle(sequence, 400).cast_signed() - 200;
    let rises = sequence % 800 < 400;
    (travel, if rises { 100 } else { -100 })
}

/// The force of the brake in newton: more at speed, up to a third less when the disc is hot.
pub fn brake_force(speed: u16, centidegrees: i16) -> u16 {
    let force = u32::from(speed) / 10;
    let heat = u32::from(centidegrees.clamp(0, 30_000).unsigned_abs());
    (force - force * heat / 90_000) as u16
}

/// Rises from 0 to `height` in steps of one, and falls again.
fn triangle(sequence: u32, height: u16) -> u16 {
    let phase = sequence % (2 * u32::from(height));
    let height = u32::from(height);
    (if phase < height { phase } else { 2 * height - phase }) as u16
}
