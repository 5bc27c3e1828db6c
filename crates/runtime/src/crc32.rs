//! CRC-32 as in zlib, PNG and gzip: polynomial 0x04C11DB7 reflected, initial value and final xor all ones.
//!
//! Based on: M. E. Kounavis and F. L. Berry, "A systematic approach to building high performance software-based CRC
//! generators" (2005): sixteen bytes a step, one table for each of them.

const POLYNOMIAL: u32 = 0xedb8_8320;

/// The remainder of each four bits. One of each byte would be a twelfth of a small module.
static TABLE: [u32; 16] = {
    let mut table = [0; 16];
    let mut bits = 0;
    while bits < 16 {
        let mut remainder = bits as u32;
        let mut bit = 0;
        while bit < 4 {
            let carry = remainder & 1;
            remainder >>= 1;
            if carry == 1 {
                remainder ^= POLYNOMIAL;
            }
            bit += 1;
        }
        table[bits] = remainder;
        bits += 1;
    }
    table
};

/// Bytes from which on it pays to make the sixteen tables, which takes a few microseconds. Kept in the program, they would
/// be more than the rest of it.
const MANY: usize = 4 << 10;

/// The remainder after one byte more.
fn remainder_of_byte(crc: u32, byte: u8) -> u32 {
    let low = crc ^ u32::from(byte);
    let half = low >> 4 ^ TABLE[(low & 15) as usize];
    half >> 4 ^ TABLE[(half & 15) as usize]
}

/// `[k][b]`: the remainder of byte b followed by k zero bytes.
fn tables() -> [[u32; 256]; 16] {
    let mut tables = [[0; 256]; 16];
    for byte in 0..=255 {
        let mut remainder = 0;
        for (k, table) in tables.iter_mut().enumerate() {
            remainder = remainder_of_byte(remainder, if k == 0 { byte } else { 0 });
            table[usize::from(byte)] = remainder;
        }
    }
    tables
}

/// The CRC-32 of `bytes`; 0 for none.
pub fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    let mut rest = bytes;
    if bytes.len() >= MANY {
        let (steps, few) = bytes.as_chunks::<16>();
        crc = remainder_of_steps(steps, crc);
        rest = few;
    }
    !rest.iter().fold(crc, |crc, &byte| remainder_of_byte(crc, byte))
}

fn remainder_of_steps(steps: &[[u8; 16]], mut crc: u32) -> u32 {
    let tables = tables();
    for step in steps {
        // What does not wait for the step before comes first.
        let mut next = 0;
        for k in 4..16 {
            next ^= tables[15 - k][step[k] as usize];
        }
        for (k, byte) in crc.to_le_bytes().into_iter().enumerate() {
            next ^= tables[15 - k][(step[k] ^ byte) as usize];
        }
        crc = next;
    }
    crc
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;

    #[test]
    fn crc32_of_the_check_string_is_the_standard_one() {
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
        assert_eq!(crc32(b""), 0);
    }

    #[test]
    fn many_bytes_a_step_equal_one_bit_a_step() {
        let bytes: Vec<u8> = (0..MANY as u32 + 40).map(|i| (i * i * 7 + 13 * i + i / 256) as u8).collect();
        for length in (0..50).chain(MANY - 20..MANY + 40) {
            let mut crc = u32::MAX;
            for &byte in &bytes[..length] {
                crc ^= u32::from(byte);
                for _ in 0..8 {
                    crc = crc >> 1 ^ if crc & 1 == 1 { POLYNOMIAL } else { 0 };
                }
            }
            assert_eq!(crc32(&bytes[..length]), !crc, "{length} bytes");
        }
    }
}
