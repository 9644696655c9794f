//! Columns that are as wide as what stands in them, and numbers with their nouns.

/// A column of a table.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Column {
    /// Its width, if nothing in it is wider.
    pub(crate) least: usize,
    /// On which side its contents stand.
    pub(crate) side: Side,
}

/// A side of a column.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Side {
    Left,
    Right,
}

/// A column of words.
pub(crate) const fn words(least: usize) -> Column {
    Column { least, side: Side::Left }
}

/// A column of numbers.
pub(crate) const fn numbers(least: usize) -> Column {
    Column { least, side: Side::Right }
}

/// The columns of one table.
#[derive(Clone, Debug)]
pub(crate) struct Columns<const N: usize>([Column; N]);

impl<const N: usize> Columns<N> {
    /// Wide enough for all these rows.
    pub(crate) fn wide_enough(mut columns: [Column; N], rows: &[[String; N]]) -> Self {
        for row in rows {
            for (column, text) in columns.iter_mut().zip(row) {
                column.least = column.least.max(text.chars().count());
            }
        }
        Self(columns)
    }

    /// A row as a line.
    pub(crate) fn line(&self, row: &[String; N]) -> String {
        let cell = |(column, text): (&Column, &String)| match column.side {
            Side::Left => format!("{text:<width$}", width = column.least),
            Side::Right => format!("{text:>width$}", width = column.least),
        };
        self.0.iter().zip(row).map(cell).collect::<Vec<_>>().join(" ")
    }

    /// How wide the columns are from `from` to before `to`, each with the space before it.
    pub(crate) fn span(&self, from: usize, to: usize) -> usize {
        self.0.iter().take(to).skip(from).map(|column| column.least + 1).sum::<usize>()
    }
}

/// `1 frame`, `2 frames`: for nouns whose plural ends in s.
pub(crate) fn counted(count: impl Into<u128>, noun: &str) -> String {
    match count.into() {
        1 => format!("1 {noun}"),
        count => format!("{count} {noun}s"),
    }
}

/// The word that goes with so many.
pub(crate) const fn agreeing<'w>(count: usize, one: &'w str, more: &'w str) -> &'w str {
    if count == 1 { one } else { more }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_follow_the_longest_text() {
        let rows = [["ü", "12345"], ["longer than that", "1"]].map(|row| row.map(str::to_owned));
        let columns = Columns::wide_enough([words(4), numbers(3)], &rows);
        assert_eq!(columns.line(&rows[0]), "ü                12345");
        assert_eq!(columns.line(&rows[1]), "longer than that     1");
        assert_eq!((columns.span(0, 1), columns.span(0, 2)), (17, 23));
    }

    #[test]
    fn nouns_agree_with_their_numbers() {
        assert_eq!([0_u64, 1, 2].map(|count| counted(count, "frame")), ["0 frames", "1 frame", "2 frames"]);
        assert_eq!(agreeing(1, "is", "are"), "is");
    }
}
