//! What a firmware binary costs, and what the control interrupts can reach in it.
//!
//! The linker leaves its relocations (`--emit-relocs`) and the compiler its frame sizes (`-Z emit-stack-sizes`) in the
//! binary, so calls and stack are read, not guessed: a relocation inside one function that refers to another is a call of
//! it. A call through a pointer leaves no relocation; the interrupts have one such, waking a task, which [`WAKING`] follows.

use object::read::elf::ElfFile32;
use object::{
    Endianness, Object, ObjectSection, ObjectSymbol, RelocationTarget, SectionFlags, SectionKind, SymbolKind,
};
use rustc_demangle::demangle;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::{fs, io};

/// The control interrupts.
const ROOTS: [&str; 3] = ["interrupts::tick", "interrupts::edge", "interrupts::period"];
/// Where the executor's wakers lead, which are called through a pointer.
const WAKING: &str = "embassy_executor::raw::waker::";
/// Beyond this the scheduler is the RTOS's: it runs for a wake-up, after the control step, and its assertions are its own.
const SCHEDULER: [&str; 3] = ["esp_rtos::", "esp_sync::", "__pender"];
/// Static memory and code in RAM, bytes.
const RAM_BUDGET: u64 = 96 * 1024;
/// What the interrupts may put on the stack, bytes.
const STACK_BUDGET: u64 = 4 * 1024;

struct Function {
    name: String,
    end: u64,
    calls: BTreeSet<u64>,
    stack: u64,
}

/// Prints the sizes and gives what is wrong, a line each.
pub fn inspect(path: &Path) -> io::Result<Vec<String>> {
    let bytes = fs::read(path).map_err(|e| io::Error::other(format!("{}: {e}", path.display())))?;
    let bad = |e: object::Error| io::Error::other(format!("{}: {e}", path.display()));
    let elf = ElfFile32::<Endianness>::parse(&*bytes).map_err(bad)?;
    let mut problems = Vec::new();

    let ram = sizes(&elf);
    if ram > RAM_BUDGET {
        problems.push(format!("static RAM is {ram} bytes, over its budget of {RAM_BUDGET}"));
    }
    let mut functions = functions(&elf);
    link(&elf, &mut functions);
    stacks(&elf, &mut functions).map_err(bad)?;

    let starts: Vec<u64> =
        functions.iter().filter(|(_, f)| ROOTS.iter().any(|r| f.name.ends_with(r))).map(|(a, _)| *a).collect();
    if starts.len() != ROOTS.len() {
        problems.push(format!("{} of the {} control interrupts are in the binary", starts.len(), ROOTS.len()));
    }
    let reached = reach(&functions, &starts);
    for (address, caller) in &reached {
        let name = &functions[address].name;
        let by = caller.map_or(String::new(), |caller| format!(" (from {})", functions[&caller].name));
        if name.contains("core::panicking") || name.contains("unwrap_failed") || name.contains("rust_begin_unwind") {
            problems.push(format!("the control interrupts can panic: {name}{by}"));
        }
        if is_float(name) {
            problems.push(format!("the control interrupts use floating point: {name}{by}"));
        }
    }
    for start in &starts {
        let depth = depth(&functions, *start, &mut BTreeMap::new());
        println!("  stack of {}: {depth} bytes", functions[start].name);
        if depth > STACK_BUDGET {
            problems.push(format!("{} takes {depth} bytes of stack, over {STACK_BUDGET}", functions[start].name));
        }
    }
    let in_flash: Vec<_> = reached.keys().filter(|a| is_flash(**a)).map(|a| functions[a].name.as_str()).collect();
    println!("  the control interrupts reach {} functions, {} of them in flash", reached.len(), in_flash.len());
    for name in in_flash {
        println!("    in flash: {name}");
    }
    Ok(problems)
}

/// Whether a function is the compiler's for floating point: `__adddf3`, `__fixsfsi`, `__floatdidf` and so on.
fn is_float(name: &str) -> bool {
    let routine = name.strip_prefix("__").is_some_and(|rest| rest.contains("sf") || rest.contains("df"));
    routine || name.contains("compiler_builtins::float")
}

/// Prints where the binary's bytes go; gives the static RAM.
fn sizes(elf: &ElfFile32<'_, Endianness>) -> u64 {
    let (mut flash, mut code, mut data, mut stack) = (0, 0, 0, 0);
    for section in elf.sections() {
        let SectionFlags::Elf { sh_flags } = section.flags() else { continue };
        let name = section.name().unwrap_or_default();
        if sh_flags & u64::from(object::elf::SHF_ALLOC) == 0 || name.contains("dummy") {
            continue;
        }
        let size = section.size();
        let stored = section.kind() != SectionKind::UninitializedData && section.file_range().is_some();
        flash += if stored { size } else { 0 };
        if name == ".stack" {
            stack = size;
        } else if !is_flash(section.address()) {
            if sh_flags & u64::from(object::elf::SHF_EXECINSTR) != 0 { code += size } else { data += size }
        }
    }
    println!("  flash {flash} bytes; RAM {code} code + {data} data; {stack} bytes left for the main stack");
    code + data
}

/// Memory-mapped flash on the RISC-V ESP32s and the ESP32: cached, so slower and away while flash is written.
fn is_flash(address: u64) -> bool {
    matches!(address >> 24, 0x3c | 0x42 | 0x43 | 0x3f) && !(0x3f80_0000..0x4000_0000).contains(&address)
}

fn functions(elf: &ElfFile32<'_, Endianness>) -> BTreeMap<u64, Function> {
    let texts = elf.symbols().filter(|symbol| symbol.kind() == SymbolKind::Text && symbol.size() > 0);
    texts
        .map(|symbol| {
            let name = format!("{:#}", demangle(symbol.name().unwrap_or_default()));
            let end = symbol.address() + symbol.size();
            (symbol.address(), Function { name, end, calls: BTreeSet::new(), stack: 0 })
        })
        .collect()
}

fn at(functions: &BTreeMap<u64, Function>, address: u64) -> Option<u64> {
    let (start, function) = functions.range(..=address).next_back()?;
    (address < function.end).then_some(*start)
}

fn link(elf: &ElfFile32<'_, Endianness>, functions: &mut BTreeMap<u64, Function>) {
    let mut calls = Vec::new();
    for section in elf.sections().filter(|section| section.kind() == SectionKind::Text) {
        for (offset, relocation) in section.relocations() {
            let RelocationTarget::Symbol(index) = relocation.target() else { continue };
            let Ok(symbol) = elf.symbol_by_index(index) else { continue };
            let target = symbol.address().wrapping_add_signed(relocation.addend());
            // In an executable, a relocation's place is an address.
            if let (Some(from), Some(to)) = (at(functions, offset), at(functions, target))
                && from != to
            {
                calls.push((from, to));
            }
        }
    }
    for (from, to) in calls {
        if let Some(function) = functions.get_mut(&from) {
            function.calls.insert(to);
        }
    }
    let wakers: BTreeSet<u64> = functions.iter().filter(|(_, f)| f.name.starts_with(WAKING)).map(|(a, _)| *a).collect();
    for function in functions.values_mut().filter(|f| ROOTS[..1].iter().any(|root| f.name.ends_with(root))) {
        function.calls.extend(&wakers);
    }
}

/// `.stack_sizes`: an address and a size in LEB128 for each function.
fn stacks(elf: &ElfFile32<'_, Endianness>, functions: &mut BTreeMap<u64, Function>) -> Result<(), object::Error> {
    let Some(section) = elf.section_by_name(".stack_sizes") else { return Ok(()) };
    let mut data = section.data()?;
    while let Some((address, rest)) = data.split_first_chunk::<4>() {
        let mut size = 0u64;
        let length = rest.iter().take_while(|byte| **byte & 0x80 != 0).count() + 1;
        for (index, byte) in rest.iter().take(length).enumerate() {
            size |= u64::from(byte & 0x7f) << (7 * index);
        }
        if let Some(function) = functions.get_mut(&u64::from(u32::from_le_bytes(*address))) {
            function.stack = size;
        }
        data = rest.get(length..).unwrap_or_default();
    }
    Ok(())
}

/// Every function that can be reached, and through which.
fn reach(functions: &BTreeMap<u64, Function>, starts: &[u64]) -> BTreeMap<u64, Option<u64>> {
    let mut reached: BTreeMap<u64, Option<u64>> = starts.iter().map(|start| (*start, None)).collect();
    let mut open = starts.to_vec();
    while let Some(from) = open.pop() {
        if SCHEDULER.iter().any(|name| functions[&from].name.contains(name)) {
            continue;
        }
        for to in &functions[&from].calls {
            if !reached.contains_key(to) {
                reached.insert(*to, Some(from));
                open.push(*to);
            }
        }
    }
    reached
}

/// The deepest stack below a function; recursion counts once.
fn depth(functions: &BTreeMap<u64, Function>, from: u64, known: &mut BTreeMap<u64, u64>) -> u64 {
    if let Some(depth) = known.get(&from) {
        return *depth;
    }
    known.insert(from, 0);
    let below = functions[&from].calls.iter().map(|to| depth(functions, *to, known)).max().unwrap_or(0);
    let total = functions[&from].stack + below;
    known.insert(from, total);
    total
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floating_point_is_told_from_wide_integers() {
        for name in
            ["__adddf3", "__mulsf3", "__fixdfsi", "__floatdidf", "__gedf2", "compiler_builtins::float::add::add"]
        {
            assert!(is_float(name), "{name}");
        }
        for name in
            ["__udivdi3", "__muldi3", "__clzsi2", "memcpy", "twum_shared::step::step", "__rustc::rust_begin_unwind"]
        {
            assert!(!is_float(name), "{name}");
        }
    }

    fn function(name: &str, calls: &[u64], stack: u64) -> Function {
        Function { name: name.into(), end: 0, calls: calls.iter().copied().collect(), stack }
    }

    #[test]
    fn reach_follows_calls_and_stops_at_the_scheduler() {
        let functions = BTreeMap::from([
            (1, function("interrupts::tick", &[2, 3], 10)),
            (2, function("step", &[4], 20)),
            (3, function("esp_rtos::wake", &[5], 30)),
            (4, function("core::panicking::panic", &[1], 40)),
            (5, function("esp_rtos::schedule", &[], 500)),
            (6, function("elsewhere", &[], 600)),
        ]);
        let reached = reach(&functions, &[1]);
        assert_eq!(reached.keys().copied().collect::<Vec<_>>(), [1, 2, 3, 4]);
        assert_eq!(reached[&4], Some(2));
        // A call back to where it came from counts once.
        assert_eq!(depth(&functions, 2, &mut BTreeMap::new()), 20 + 40 + 10 + 30 + 500);
    }

    #[test]
    fn flash_is_told_from_ram() {
        for flash in [0x3c00_0020, 0x4201_0020, 0x3f40_0020] {
            assert!(is_flash(flash), "{flash:#x}");
        }
        for ram in [0x3fc8_0000, 0x4038_0000, 0x4080_0000, 0x3ffb_0000, 0x4008_0000, 0x5000_0000] {
            assert!(!is_flash(ram), "{ram:#x}");
        }
    }
}
