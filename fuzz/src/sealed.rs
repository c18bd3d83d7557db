//! Frames around any bytes at all, with a checksum that is right: a fuzzer does not find one by itself. Written from the
//! format's description, not with the project's own encoder.

use twum_shared::frame::PROTOCOL_VERSION;

/// A frame of this kind around `message`, its separator included.
pub fn frame(kind: u8, sequence: u32, time_us: u64, message: &[u8]) -> Vec<u8> {
    let mut plain = vec![PROTOCOL_VERSION, kind];
    plain.extend(sequence.to_le_bytes());
    plain.extend(time_us.to_le_bytes());
    plain.extend(message);
    plain.extend(crc32(&plain).to_le_bytes());
    let mut line = stuffed(&plain);
    line.push(0);
    line
}

/// CRC-32/ISO-HDLC, four bits at a time.
fn crc32(bytes: &[u8]) -> u32 {
    const TABLE: [u32; 16] = {
        let mut table = [0; 16];
        let mut index = 0;
        while index < 16 {
            let mut value = index as u32;
            let mut bit = 0;
            while bit < 4 {
                value = if value & 1 == 1 { 0xEDB8_8320 ^ (value >> 1) } else { value >> 1 };
                bit += 1;
            }
            table[index] = value;
            index += 1;
        }
        table
    };
    let mut crc = u32::MAX;
    for byte in bytes {
        crc ^= u32::from(*byte);
        crc = TABLE[(crc & 15) as usize] ^ (crc >> 4);
        crc = TABLE[(crc & 15) as usize] ^ (crc >> 4);
    }
    !crc
}

/// Consistent overhead byte stuffing.
fn stuffed(plain: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(plain.len() + plain.len() / 254 + 1);
    let mut code_at = 0;
    out.push(1);
    for (index, byte) in plain.iter().enumerate() {
        if *byte == 0 {
            code_at = out.len();
            out.push(1);
            continue;
        }
        out.push(*byte);
        out[code_at] += 1;
        if out[code_at] == 255 && index + 1 < plain.len() {
            code_at = out.len();
            out.push(1);
        }
    }
    out
}
