//! The block an instrument answers with.

use twum_host::instruments::scpi::take_block;

/// The bytes are a stream as it arrives: every beginning of it has to agree with the whole.
pub fn blocks(data: &[u8]) {
    let whole = take_block(data);
    if let Ok(Some(block)) = &whole {
        let taken = data.len() - block.rest.len();
        assert!(data.ends_with(block.rest) && data[..taken].ends_with(block.data));
        let text = data.trim_ascii_start();
        let digits = usize::from(text[1] - b'0');
        let length: usize = std::str::from_utf8(&text[2..2 + digits]).unwrap().parse().unwrap();
        assert_eq!(length, block.data.len());
        assert_eq!(take_block(&data[..taken]).map(|block| block.map(|block| block.data)), Ok(Some(block.data)));
    }
    for cut in 0..data.len().min(32) {
        match (take_block(&data[..cut]), &whole) {
            (Ok(None), _) => {}
            (Ok(Some(early)), Ok(Some(block))) => assert_eq!(early.data, block.data),
            (Err(_), Err(_)) => {}
            (early, whole) => panic!("{early:?} after {cut} bytes, {whole:?} in the end"),
        }
    }
}
