//! The story of the cut as a picture: when each command was published, and when it was on the far bus.

use svg::Document;
use svg::node::element::{Circle, Line, Rectangle, Text};

use crate::commands::Story;

/// Draws it.
pub fn draw(story: &Story) -> String {
    let end = story.commands.last().map_or(1.0, |command| command.published).max(0.1);
    let x = |at: f64| LEFT + at / end * (WIDTH - LEFT - 20.0);
    let mut document = Document::new()
        .set("viewBox", (0, 0, WIDTH, HEIGHT))
        .set("font-family", "sans-serif")
        .set("font-size", 13)
        .add(Rectangle::new().set("width", WIDTH).set("height", HEIGHT).set("fill", "white"))
        .add(
            Text::new("Commands across a cut: published in the west, on the bus in the east")
                .set("x", LEFT)
                .set("y", 24)
                .set("font-size", 15),
        )
        .add(rectangle(x(story.cut.0), x(story.cut.1)))
        .add(
            Text::new("the way is cut")
                .set("x", x(story.cut.0) + 6.0)
                .set("y", TOP - 6.0)
                .set("fill", "#555"),
        );
    for (lane, label) in [(TOP + 20.0, "published"), (BOTTOM - 20.0, "on the far bus")] {
        document = document.add(Text::new(label).set("x", 8).set("y", lane + 4.0)).add(line(
            (LEFT, lane),
            (WIDTH - 20.0, lane),
            "#ccc",
            1.0,
        ));
    }
    for command in &story.commands {
        let from = (x(command.published), TOP + 20.0);
        match command.arrived {
            Some(arrived) => {
                let to = (x(arrived), BOTTOM - 20.0);
                document = document.add(line(from, to, BLUE, 0.7)).add(dot(to, BLUE)).add(dot(from, BLUE));
            }
            // A bar that ends on the way: told apart by its form, too.
            None => document = document.add(line(from, (from.0, from.1 + 24.0), ORANGE, 1.0)),
        }
    }
    for second in 0..=(end as u32) {
        let at = x(f64::from(second));
        document = document
            .add(line((at, BOTTOM), (at, BOTTOM + 5.0), "#333", 1.0))
            .add(Text::new(format!("{second}")).set("x", at - 4.0).set("y", BOTTOM + 20.0));
    }
    let legend = "blue: crossed; orange, short: never on the far bus. Seconds.";
    document.add(Text::new(legend).set("x", LEFT).set("y", HEIGHT - 10.0).set("fill", "#333")).to_string()
}

fn rectangle(from: f64, until: f64) -> Rectangle {
    let width = (until - from).max(1.0);
    Rectangle::new()
        .set("x", from)
        .set("y", TOP)
        .set("width", width)
        .set("height", BOTTOM - TOP)
        .set("fill", "#eee")
}

fn line(from: (f64, f64), to: (f64, f64), colour: &str, width: f64) -> Line {
    Line::new()
        .set("x1", from.0)
        .set("y1", from.1)
        .set("x2", to.0)
        .set("y2", to.1)
        .set("stroke", colour)
        .set("stroke-width", width)
}

fn dot(at: (f64, f64), colour: &str) -> Circle {
    Circle::new().set("cx", at.0).set("cy", at.1).set("r", 1.6).set("fill", colour)
}

const WIDTH: f64 = 1000.0;
const HEIGHT: f64 = 300.0;
const LEFT: f64 = 110.0;
const TOP: f64 = 60.0;
const BOTTOM: f64 = 235.0;
const BLUE: &str = "#0072b2";
const ORANGE: &str = "#d55e00";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::Command;

    #[test]
    fn what_crossed_and_what_did_not_look_different() {
        let command = |published, arrived| Command { published, arrived };
        let commands = vec![command(0.5, Some(0.6)), command(1.5, None), command(3.0, Some(3.1))];
        let story = Story { cut: (1.0, 2.0), commands, twice: 0, temperatures: (1, 1) };
        let picture = draw(&story);
        assert_eq!((picture.matches(BLUE).count(), picture.matches(ORANGE).count()), (6, 1));
        assert!(story.stale().is_empty());
        assert_eq!(story.arrived(), [(1, 1), (0, 1), (1, 1)]);
    }

    #[test]
    fn a_stale_command_is_found() {
        let stale = Command { published: 1.2, arrived: Some(2.1) };
        let fresh = Command { published: 1.9, arrived: Some(2.1) };
        let story = Story { cut: (1.0, 2.0), commands: vec![stale, fresh], twice: 0, temperatures: (1, 1) };
        assert_eq!(story.stale(), [0]);
    }
}
