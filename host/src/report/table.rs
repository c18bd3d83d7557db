//! Tables for a terminal.

use comfy_table::{CellAlignment, Table, presets};

/// Rows under a header, each column as wide as it needs, columns of numbers set right; ends with a line feed.
pub fn table<H: AsRef<str>>(header: &[H], rows: &[Vec<String>]) -> String {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(header.iter().map(AsRef::as_ref)).add_rows(rows);
    for (index, column) in table.column_iter_mut().enumerate() {
        column.set_padding((0, 2));
        if !rows.is_empty() && rows.iter().all(|row| row.get(index).is_none_or(|cell| is_number(cell))) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table.trim_fmt() + "\n"
}

/// A number, or what stands for one that is not there.
fn is_number(cell: &str) -> bool {
    cell == "-" || cell.trim_end_matches(['%', ' ']).parse::<f64>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_of_numbers_are_set_right() {
        let rows =
            [["a", "1.5", "x 1"], ["bcd", "-", "2"], ["", "10 %", ""]].map(|row| row.map(str::to_owned).to_vec());
        assert_eq!(table(&["run", "r", "t"], &rows), "run     r  t\na     1.5  x 1\nbcd     -  2\n     10 %\n");
    }
}
