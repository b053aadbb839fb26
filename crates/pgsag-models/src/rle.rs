//! Run lengths as COCO writes them: column by column, zeros first, differences in a compressed string.

use pgsag_scene::Map;

/// Lengths of runs of zeros and ones in turn, column-major.
#[must_use]
pub fn runs(mask: &Map<bool>) -> Vec<u32> {
    let (mut runs, mut value, mut length) = (Vec::new(), false, 0);
    for x in 0..mask.width {
        for y in 0..mask.height {
            if mask.at(x, y) != value {
                runs.push(length);
                (value, length) = (!value, 0);
            }
            length += 1;
        }
    }
    runs.push(length);
    runs
}

/// COCO's string of run lengths: from the fourth on, differences to the one before the last; five bits a letter.
#[must_use]
pub fn encode(mask: &Map<bool>) -> String {
    let runs = runs(mask);
    let mut text = String::new();
    for (index, run) in runs.iter().enumerate() {
        let mut rest = i64::from(*run) - if index > 2 { i64::from(runs[index - 2]) } else { 0 };
        loop {
            let mut letter = (rest & 0x1f) as u8;
            rest >>= 5;
            let goes_on = if letter & 0x10 != 0 { rest != -1 } else { rest != 0 };
            letter |= if goes_on { 0x20 } else { 0 };
            text.push(char::from(letter + 48));
            if !goes_on {
                break;
            }
        }
    }
    text
}

/// The mask of a COCO string; `None` where it is not one of this size.
#[must_use]
pub fn decode(text: &str, width: u32, height: u32) -> Option<Map<bool>> {
    let count = i64::from(width).checked_mul(i64::from(height))?;
    let (mut runs, mut value, mut shift): (Vec<i64>, i64, u32) = (Vec::new(), 0, 0);
    let mut left = count;
    for letter in text.bytes() {
        let bits = i64::from(letter.checked_sub(48).filter(|bits| *bits < 64)?);
        value |= (bits & 0x1f).checked_shl(shift).filter(|_| shift < 40)?;
        shift += 5;
        if bits & 0x20 == 0 {
            value |= if bits & 0x10 != 0 { -1 << shift } else { 0 };
            let run = value + if runs.len() > 2 { runs[runs.len() - 2] } else { 0 };
            left -= Some(run).filter(|run| (0..=left).contains(run))?;
            runs.push(run);
            (value, shift) = (0, 0);
        }
    }
    if left != 0 || shift != 0 {
        return None;
    }
    let columns = runs.iter().enumerate().flat_map(|(i, &run)| std::iter::repeat_n(i % 2 == 1, run as usize));
    let mut mask = Map::filled(width, height, false);
    for (index, _) in columns.enumerate().filter(|(_, inside)| *inside) {
        mask.set(index as u32 / height, index as u32 % height, true);
    }
    Some(mask)
}

#[cfg(test)]
mod tests;
