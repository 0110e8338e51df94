//! The part of DXF that a contour needs.
//! It reads header units and plane entities from text or binary, and writes lines.
//!
//! Source: Autodesk, DXF reference, "Group code value types", "Binary DXF files" and "ENTITIES section".

use rtec_files::InputError;
use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::path::Path;

/// One group of a file. Lines count from 1; in a binary file they are 0.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Group {
    pub(crate) code: i32,
    pub(crate) value: String,
    pub(crate) line: usize,
}

/// The parts of a drawing that a contour needs.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Drawing {
    /// `$INSUNITS`; 0 if the header does not have it.
    pub(crate) units: i32,
    /// Hidden layers in lower case: off, frozen, or never plotted.
    pub(crate) hidden_layers: Vec<String>,
    pub(crate) entities: Vec<Entity>,
    pub(crate) blocks: Vec<Block>,
}

/// Entities that INSERT puts into the drawing.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Block {
    pub(crate) name: String,
    /// The block's base point, which is put at the place of insertion.
    pub(crate) base: [f64; 3],
    pub(crate) entities: Vec<Entity>,
}

/// One entity of the ENTITIES section with its own groups.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Entity {
    /// The kind: LINE, ARC and so on.
    pub(crate) kind: String,
    /// The handle in capitals; empty if it has none.
    pub(crate) handle: String,
    pub(crate) layer: String,
    pub(crate) visible: bool,
    pub(crate) in_paper_space: bool,
    /// The line of its handle, or of its name if it has none.
    pub(crate) line: usize,
    groups: Vec<Group>,
    /// The vertices of a POLYLINE.
    pub(crate) vertices: Vec<Entity>,
}

/// The first bytes of a binary DXF.
const BINARY: &[u8] = b"AutoCAD Binary DXF\r\n\x1a\0";

/// The group codes of numbers with decimals.
const DECIMALS: [RangeInclusive<i32>; 5] = [10..=59, 110..=149, 210..=239, 460..=469, 1010..=1059];

/// Flag of a layer that is frozen (group code 70 of LAYER).
const FROZEN: i64 = 1;

/// The names of `$INSUNITS`, by number.
const UNITS: &str = "unitless,inches,feet,miles,mm,cm,m,km,microinches,mils,yards,ångströms,nm,µm,dm,dam,hm,Gm,\
                     astronomical units,light years,parsecs";

fn is_decimal(code: i32) -> bool {
    DECIMALS.iter().any(|range| range.contains(&code))
}

impl Entity {
    /// The values of one group code, in order.
    /// The reader has checked that they are numbers.
    pub(crate) fn all(&self, code: i32) -> impl Iterator<Item = f64> {
        self.groups.iter().filter(move |g| g.code == code).filter_map(|g| g.value.parse().ok())
    }

    /// The last value of a group code.
    pub(crate) fn number(&self, code: i32) -> Option<f64> {
        self.all(code).last()
    }

    /// The name of a block, or of the block that it inserts.
    pub(crate) fn name(&self) -> &str {
        self.groups.iter().find(|g| g.code == 2).map_or("", |g| g.value.as_str())
    }

    pub(crate) fn flags(&self) -> i32 {
        self.number(70).unwrap_or(0.0) as i32
    }

    /// X, Y and Z at three group codes.
    pub(crate) fn point(&self, code: i32) -> [f64; 3] {
        [code, code + 10, code + 20].map(|c| self.number(c).unwrap_or(0.0))
    }

    /// The extrusion direction.
    pub(crate) fn normal(&self) -> [f64; 3] {
        let z_axis = [0.0, 0.0, 1.0];
        [0, 1, 2].map(|i| self.number(210 + 10 * i as i32).unwrap_or(z_axis[i]))
    }

    /// Each X with the values that follow it up to the next X.
    /// A missing code gives 0.
    pub(crate) fn rows<const N: usize>(&self, codes: [i32; N]) -> Vec<[f64; N]> {
        let mut rows: Vec<[f64; N]> = Vec::new();
        for group in &self.groups {
            let Some(column) = codes.iter().position(|c| *c == group.code) else { continue };
            if column == 0 {
                rows.push([0.0; N]);
            }
            if let (Some(row), Ok(value)) = (rows.last_mut(), group.value.parse()) {
                row[column] = value;
            }
        }
        rows
    }
}

impl Drawing {
    /// The unit's name.
    pub(crate) fn unit_name(&self) -> String {
        let known = usize::try_from(self.units).ok().and_then(|n| UNITS.split(',').nth(n));
        known.map_or_else(|| format!("number {}", self.units), str::to_owned)
    }

    /// Reads a drawing.
    ///
    /// # Errors
    /// The first invalid group, and its line; a file that ends in the middle.
    pub(crate) fn of(file: &Path, bytes: &[u8]) -> Result<Self, InputError> {
        let groups = if bytes.starts_with(BINARY) { of_binary(file, bytes)? } else { of_text(file, bytes)? };
        let mut drawing = Self { hidden_layers: vec!["defpoints".to_owned()], ..Self::default() };
        let mut rest = &groups[..];
        while let Some((first, after)) = rest.split_first() {
            if (first.code, &*first.value) == (0, "EOF") {
                return Ok(drawing);
            }
            let section = after.first().filter(|g| g.code == 2);
            let (true, Some(section)) = ((first.code, &*first.value) == (0, "SECTION"), section) else {
                let found = format!("group {} '{}'", first.code, first.value);
                let expected = "a DXF drawing: 0 SECTION and 2 NAME, or 0 EOF";
                return Err(InputError::at(file, first.line, 0, found, expected));
            };
            let Some(end) = after.iter().position(|g| (g.code, &*g.value) == (0, "ENDSEC")) else {
                let found = format!("the end of the file within the section {}", section.value);
                let expected = "a DXF drawing: 0 ENDSEC after each section";
                return Err(InputError::at(file, section.line, 0, found, expected));
            };
            let content = &after[1..end];
            match &*section.value {
                "HEADER" => drawing.units = units(content),
                "TABLES" => drawing.hidden_layers.extend(hidden_layers(content)),
                "BLOCKS" => drawing.blocks = blocks(content),
                "ENTITIES" => drawing.entities = entities(content),
                _ => {}
            }
            rest = &after[end + 1..];
        }
        if groups.is_empty() {
            return Err(InputError::whole(file, "an empty file", "a DXF drawing"));
        }
        Ok(drawing)
    }
}

fn units(header: &[Group]) -> i32 {
    let at = header.iter().position(|g| g.code == 9 && g.value == "$INSUNITS");
    at.and_then(|i| header.get(i + 1)).and_then(|g| g.value.parse().ok()).unwrap_or(0)
}

/// Splits groups into records: from each group 0 to the next.
fn records(groups: &[Group]) -> impl Iterator<Item = &[Group]> {
    let from = groups.iter().position(|g| g.code == 0).unwrap_or(groups.len());
    let mut rest = &groups[from..];
    std::iter::from_fn(move || {
        let end = rest.iter().skip(1).position(|g| g.code == 0).map_or(rest.len(), |i| i + 1);
        let (record, after) = rest.split_at(end);
        rest = after;
        (!record.is_empty()).then_some(record)
    })
}

/// The layers that are off (a colour below zero) or frozen.
fn hidden_layers(tables: &[Group]) -> Vec<String> {
    let value = |record: &[Group], code: i32| record.iter().find(|g| g.code == code).map(|g| g.value.clone());
    let number =
        |record: &[Group], code: i32| value(record, code).and_then(|v| v.parse::<i64>().ok()).unwrap_or(0);
    let layers = records(tables).filter(|r| r[0].value == "LAYER");
    let hidden = layers.filter(|r| number(r, 62) < 0 || number(r, 70) & FROZEN != 0);
    hidden.filter_map(|r| value(r, 2)).map(|name| name.to_lowercase()).collect()
}

fn blocks(section: &[Group]) -> Vec<Block> {
    let mut found: Vec<Block> = Vec::new();
    for entity in entities(section) {
        match (&*entity.kind, found.last_mut()) {
            ("BLOCK", _) => {
                let (name, base) = (entity.name().to_owned(), entity.point(10));
                found.push(Block { name, base, entities: Vec::new() });
            }
            ("ENDBLK", _) | (_, None) => {}
            (_, Some(block)) => block.entities.push(entity),
        }
    }
    found
}

fn entities(section: &[Group]) -> Vec<Entity> {
    let mut found: Vec<Entity> = Vec::new();
    // Whether VERTEX and ATTRIB belong to the entity before.
    let mut open = false;
    for record in records(section) {
        let entity = entity(record);
        match &*entity.kind {
            "SEQEND" => open = false,
            "VERTEX" | "ATTRIB" if open => {
                if let Some(owner) = found.last_mut() {
                    owner.vertices.push(entity);
                }
            }
            kind => {
                open = kind == "POLYLINE" || kind == "INSERT" && entity.number(66) == Some(1.0);
                found.push(entity);
            }
        }
    }
    found
}

fn entity(record: &[Group]) -> Entity {
    // Groups within braces (102) and those from 1000 on are application data.
    let mut depth = 0_i32;
    let own = |g: &&Group| {
        if g.code == 102 {
            depth += if g.value.starts_with('{') { 1 } else { -1 };
        }
        depth <= 0 && g.code < 1000
    };
    let groups: Vec<Group> = record[1..].iter().filter(own).cloned().collect();
    let value = |code: i32| groups.iter().find(|g| g.code == code);
    let is_set = |code: i32| value(code).is_some_and(|g| g.value == "1");
    let handle = value(5).map(|g| g.value.trim_start_matches('0').to_uppercase());
    Entity {
        kind: record[0].value.clone(),
        handle: handle.unwrap_or_default(),
        layer: value(8).map_or("0", |g| &*g.value).to_owned(),
        visible: !is_set(60),
        in_paper_space: is_set(67),
        line: value(5).unwrap_or(&record[0]).line,
        vertices: Vec::new(),
        groups,
    }
}

fn of_text(file: &Path, bytes: &[u8]) -> Result<Vec<Group>, InputError> {
    // Since AutoCAD 2007 the text is UTF-8, before that in the computer's code page, mostly Windows-1252. In
    // another code page names are wrong, but no number.
    let decoded = rtec_files::text_file::decode_western(file, bytes);
    let text = decoded.map_or_else(|_| String::from_utf8_lossy(bytes).into_owned(), |(text, _)| text);
    let text = if text.contains('\n') { text } else { text.replace('\r', "\n") };
    let mut groups = Vec::new();
    let mut lines = text.lines().enumerate();
    while let Some((i, code)) = lines.next() {
        let code = code.trim();
        if code.is_empty() && lines.clone().all(|(_, l)| l.trim().is_empty()) {
            break;
        }
        let Ok(number) = code.parse::<i32>() else {
            let found = format!("'{}'", code.chars().take(40).collect::<String>());
            let expected = "a DXF drawing: a group code, which is a whole number";
            return Err(InputError::at(file, i + 1, 0, found, expected));
        };
        let Some((i, value)) = lines.next() else {
            let found = format!("the end of the file after the group code {number}");
            return Err(InputError::at(file, i + 1, 0, found, "a DXF drawing: a value for each group code"));
        };
        let value =
            if is_words(number) { unescaped(value.trim_end_matches('\r')) } else { value.trim().to_owned() };
        groups.push(Group { code: number, value, line: i + 1 });
    }
    groups.iter().try_for_each(|group| check(file, group))?;
    Ok(groups)
}

/// Whether a group code is of text, in which blanks may count.
fn is_words(code: i32) -> bool {
    matches!(code, 1..=4 | 6..=8 | 1000..=1003)
}

/// Checks that a group of numbers has a number.
fn check(file: &Path, group: &Group) -> Result<(), InputError> {
    if is_decimal(group.code) && group.value.parse::<f64>().is_err() {
        let found = format!("'{}'", group.value.chars().take(40).collect::<String>());
        let comma =
            group.value.matches(',').count() == 1 && group.value.replace(',', ".").parse::<f64>().is_ok();
        let expected =
            if comma { "a number with a decimal point, as DXF has it" } else { "a DXF drawing: a number" };
        return Err(InputError::at(file, group.line, 0, found, expected));
    }
    Ok(())
}

/// Decodes `\U+00E4`.
/// Files before R2007 write it for letters outside their code page.
fn unescaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut parts = text.split("\\U+");
    out.push_str(parts.next().unwrap_or_default());
    for part in parts {
        let letter = part.get(..4).and_then(|hex| u32::from_str_radix(hex, 16).ok()).and_then(char::from_u32);
        match letter {
            Some(letter) => {
                out.push(letter);
                out.push_str(&part[4..]);
            }
            None => out.extend(["\\U+", part]),
        }
    }
    out
}

/// A position in a binary file, for reading.
struct ByteCursor<'a> {
    file: &'a Path,
    all: &'a [u8],
    at: usize,
}

impl ByteCursor<'_> {
    fn take(&mut self, n: usize) -> Result<&[u8], InputError> {
        let (at, taken) = (self.at, self.all.get(self.at..self.at.saturating_add(n)));
        self.at += n;
        taken.ok_or_else(|| {
            let found = format!("the end of the file at byte {at}");
            InputError::whole(self.file, found, "a DXF drawing: binary groups up to 0 EOF")
        })
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], InputError> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(N)?);
        Ok(out)
    }

    fn text(&mut self) -> Result<String, InputError> {
        let n = self.all.get(self.at..).and_then(|rest| rest.iter().position(|b| *b == 0));
        let bytes = self.take(n.map_or(usize::MAX / 2, |n| n + 1))?;
        let bytes = &bytes[..bytes.len() - 1];
        Ok(unescaped(&String::from_utf8_lossy(bytes)))
    }
}

fn of_binary(file: &Path, all: &[u8]) -> Result<Vec<Group>, InputError> {
    let mut bytes = ByteCursor { file, all, at: BINARY.len() };
    // Since AutoCAD 13 a group code has two bytes. The first code is 0, so there are two zeros.
    let wide = all.get(BINARY.len() + 1) == Some(&0);
    let mut groups = Vec::new();
    while bytes.at < all.len() {
        let at = bytes.at;
        let mut code = if wide {
            i32::from(i16::from_le_bytes(bytes.array()?))
        } else {
            i32::from(bytes.array::<1>()?[0])
        };
        if !wide && code == 255 {
            code = i32::from(i16::from_le_bytes(bytes.array()?));
        }
        let value = match code {
            _ if is_decimal(code) => f64::from_le_bytes(bytes.array()?).to_string(),
            60..=79 | 170..=179 | 270..=289 | 370..=389 | 400..=409 | 1060..=1070 => {
                i16::from_le_bytes(bytes.array()?).to_string()
            }
            90..=99 | 420..=429 | 440..=459 | 1071 => i32::from_le_bytes(bytes.array()?).to_string(),
            160..=169 => i64::from_le_bytes(bytes.array()?).to_string(),
            290..=299 => bytes.array::<1>()?[0].to_string(),
            310..=319 | 1004 => {
                let n = usize::from(bytes.array::<1>()?[0]);
                bytes.take(n)?;
                String::new()
            }
            0..=9 | 100..=109 | 300..=369 | 390..=399 | 410..=419 | 430..=439 | 470..=481 | 999..=1009 => {
                bytes.text()?
            }
            _ => {
                let found = format!("group code {code} at byte {at}");
                let expected = "a DXF drawing: a group code of the DXF reference";
                return Err(InputError::whole(file, found, expected));
            }
        };
        let is_end = (code, &*value) == (0, "EOF");
        groups.push(Group { code, value, line: 0 });
        if is_end {
            break;
        }
    }
    Ok(groups)
}

/// A drawing of lines as text, in mm, R2000: from X, Y to X, Y on a layer.
/// The same lines give the same bytes.
pub(crate) fn written(lines: &[([f64; 2], [f64; 2], &str)]) -> String {
    let mut layers: Vec<&str> = lines.iter().map(|(.., layer)| *layer).collect();
    layers.sort_unstable();
    layers.dedup();
    // AutoCAD 2000 needs these parts in every drawing, with the handles that the entries refer to.
    let (before, after) = EMPTY.split_once("0\nENTITIES\n").unwrap_or((EMPTY, ""));
    let mut out = String::new();
    let first = 0x100;
    let mut handles = first..;
    let mut handle = || handles.next().unwrap_or(first);
    let mut table = String::new();
    for name in layers {
        let _ = write!(
            table,
            "0\nLAYER\n5\n{:X}\n330\n2\n100\nAcDbSymbolTableRecord\n100\nAcDbLayerTableRecord\n2\n{name}\n70\n0\n62\n7\n6\nContinuous\n",
            handle()
        );
    }
    out.push_str(&before.replace("0\nLAYERS\n", &table));
    for (a, b, layer) in lines {
        let _ = write!(
            out,
            "0\nLINE\n5\n{:X}\n330\n1F\n100\nAcDbEntity\n8\n{layer}\n100\nAcDbLine\n10\n{:?}\n20\n{:?}\n30\n0.0\n11\n{:?}\n21\n{:?}\n31\n0.0\n",
            handle(),
            a[0],
            a[1],
            b[0],
            b[1]
        );
    }
    out.push_str(after);
    out.replace("0\nNEXT\n", &format!("{:X}\n", handle()))
}

/// An empty drawing with three places to fill.
/// They are LAYERS, ENTITIES and NEXT, the next free handle.
const EMPTY: &str = include_str!("empty.dxf");
