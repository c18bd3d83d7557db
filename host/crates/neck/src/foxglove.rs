//! Sessions as an MCAP file that plays in Foxglove: frame transforms of the reference and the true neck, a head to see
//! them by, and the numbers to plot.
//!
//! Foxglove knows `foxglove.FrameTransform` and `foxglove.SceneUpdate` by name; the schemas here list the fields used.

use super::kinematics::{JOINTS, Wrist};
use super::session::Session;
use mcap::records::MessageHeader;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::{Seek, Write};
use twum_record::store::VIRTUAL_EPOCH_NS;

/// Topic of the frame transforms.
pub const TOPIC_TRANSFORMS: &str = "/neck/transforms";
/// Topic of the heads.
pub const TOPIC_SCENE: &str = "/neck/scene";
/// Topic of the numbers.
pub const TOPIC_STATE: &str = "/neck/state";
/// The manipulator's base.
pub const BASE_FRAME: &str = "base";

/// Time between messages, ns.
const STEP_NS: u64 = 20_000_000;
/// Rest between two sessions, ns.
const PAUSE_NS: u64 = 1_000_000_000;

/// Writes the sessions one after the other. Equal sessions give equal bytes: time starts at the virtual epoch.
///
/// # Errors
/// When the system takes no more.
pub fn write(sessions: &[&Session], to: impl Write + Seek) -> Result<(), mcap::McapError> {
    let options =
        mcap::WriteOptions::new().profile("").library(format!("twum {}", env!("CARGO_PKG_VERSION"))).compression(None);
    let mut writer = options.create(to)?;
    let mut channel = |schema_name: &str, schema: Value, topic: &str| -> Result<u16, mcap::McapError> {
        let schema = writer.add_schema(schema_name, "jsonschema", schema.to_string().as_bytes())?;
        writer.add_channel(schema, topic, "json", &BTreeMap::new())
    };
    let transforms = channel("foxglove.FrameTransform", transform_schema(), TOPIC_TRANSFORMS)?;
    let scene = channel("foxglove.SceneUpdate", scene_schema(), TOPIC_SCENE)?;
    let state = channel("twum.NeckState", state_schema(), TOPIC_STATE)?;

    let mut sequence = 0;
    let mut begin_ns = VIRTUAL_EPOCH_NS;
    for session in sessions {
        let stride_ticks = ((STEP_NS as f64 * 1e-9 / session.tick_s).round() as usize).max(1);
        for (index, tick) in (0..session.len()).step_by(stride_ticks).enumerate() {
            let time_ns = begin_ns + (session.time_s(tick) * 1e9).round() as u64;
            let poses = [("reference", session.reference_deg(tick)), ("true", session.joints_deg(tick))];
            let mut messages = Vec::with_capacity(2 * JOINTS + 2);
            for (tree, pose) in poses {
                messages.extend(links(session.wrist, tree, pose, time_ns).map(|message| (transforms, message)));
            }
            if index == 0 {
                messages.push((scene, heads(session.wrist, time_ns)));
            }
            messages.push((state, numbers(session, tick)));
            for (channel_id, message) in messages {
                let header = MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
                writer.write_to_known_channel(&header, message.to_string().as_bytes())?;
                sequence = sequence.wrapping_add(1);
            }
        }
        begin_ns += (session.exercise.duration_s() * 1e9).round() as u64 + PAUSE_NS;
    }
    writer.finish().map(|_| ())
}

/// The frame of a link: `true/link1`, `true/link2`, `true/head`, and the same of `reference`.
fn frame(tree: &str, link: usize) -> String {
    match link {
        0 => BASE_FRAME.to_owned(),
        JOINTS => format!("{tree}/head"),
        _ => format!("{tree}/link{link}"),
    }
}

fn links(wrist: Wrist, tree: &str, pose_deg: [f64; JOINTS], time_ns: u64) -> [Value; JOINTS] {
    let frames = wrist.frames(pose_deg);
    std::array::from_fn(|joint| {
        let (shift, turn) = (frames[joint].translation, frames[joint].rotation);
        json!({
            "timestamp": time(time_ns),
            "parent_frame_id": frame(tree, joint),
            "child_frame_id": frame(tree, joint + 1),
            "translation": {"x": shift.x, "y": shift.y, "z": shift.z},
            "rotation": {"x": turn.i, "y": turn.j, "z": turn.k, "w": turn.w},
        })
    })
}

/// A head and a neck on each tree's head frame, whose origin is the end point.
fn heads(wrist: Wrist, time_ns: u64) -> Value {
    let length = wrist.length_m;
    let upright = |z: f64| json!({"position": {"x": 0.0, "y": 0.0, "z": z}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}});
    let entity = |tree: &str, [r, g, b, a]: [f64; 4]| {
        let color = json!({"r": r, "g": g, "b": b, "a": a});
        let empty = json!([]);
        json!({
            "timestamp": time(time_ns),
            "frame_id": frame(tree, JOINTS),
            "id": tree,
            "lifetime": {"sec": 0, "nsec": 0},
            "frame_locked": true,
            "metadata": empty,
            "arrows": empty,
            "cubes": [{
                // The nose tells where the face looks.
                "pose": {"position": {"x": 0.0, "y": 0.42 * length, "z": -0.42 * length}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}},
                "size": {"x": 0.08 * length, "y": 0.12 * length, "z": 0.16 * length},
                "color": color,
            }],
            "spheres": [{
                "pose": upright(-0.44 * length),
                "size": {"x": 0.62 * length, "y": 0.76 * length, "z": 0.88 * length},
                "color": color,
            }],
            "cylinders": [{
                "pose": upright(-0.9 * length),
                "size": {"x": 0.3 * length, "y": 0.3 * length, "z": 0.2 * length},
                "bottom_scale": 1.0,
                "top_scale": 1.0,
                "color": color,
            }],
            "lines": empty,
            "triangles": empty,
            "texts": empty,
            "models": empty,
        })
    };
    json!({
        "deletions": [],
        "entities": [entity("true", [0.84, 0.37, 0.0, 1.0]), entity("reference", [0.0, 0.45, 0.7, 0.3])],
    })
}

fn numbers(session: &Session, tick: usize) -> Value {
    let (reference, actual) = (session.reference_deg(tick), session.joints_deg(tick));
    let point = |pose| {
        let point = session.wrist.end_point_m(pose);
        json!({"x": point.x, "y": point.y, "z": point.z})
    };
    let joint = |joint: usize| {
        json!({
            "reference_deg": reference[joint],
            "true_deg": actual[joint],
            "error_deg": actual[joint] - reference[joint],
            "drive": session.joints[joint].drive[tick],
        })
    };
    json!({
        "exercise": session.exercise.name(),
        "time_s": session.time_s(tick),
        "joint1": joint(0),
        "joint2": joint(1),
        "joint3": joint(2),
        "reference_m": point(reference),
        "true_m": point(actual),
        "error_m": session.error_m(tick),
    })
}

fn time(ns: u64) -> Value {
    json!({"sec": ns / 1_000_000_000, "nsec": ns % 1_000_000_000})
}

fn object<const N: usize>(properties: [(&str, Value); N]) -> Value {
    let properties: serde_json::Map<String, Value> =
        properties.into_iter().map(|(name, schema)| (name.to_owned(), schema)).collect();
    json!({"type": "object", "properties": properties})
}

fn number() -> Value {
    json!({"type": "number"})
}

fn vector() -> Value {
    object([("x", number()), ("y", number()), ("z", number())])
}

fn quaternion() -> Value {
    object([("x", number()), ("y", number()), ("z", number()), ("w", number())])
}

fn stamp(title: &str) -> Value {
    json!({
        "type": "object",
        "title": title,
        "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999}},
    })
}

fn titled(title: &str, mut schema: Value) -> Value {
    schema["title"] = json!(title);
    schema["$schema"] = json!("https://json-schema.org/draft/2020-12/schema");
    schema
}

fn transform_schema() -> Value {
    titled(
        "foxglove.FrameTransform",
        object([
            ("timestamp", stamp("time")),
            ("parent_frame_id", json!({"type": "string"})),
            ("child_frame_id", json!({"type": "string"})),
            ("translation", vector()),
            ("rotation", quaternion()),
        ]),
    )
}

fn scene_schema() -> Value {
    let list = |items: Value| json!({"type": "array", "items": items});
    let pose = || object([("position", vector()), ("orientation", quaternion())]);
    let color = || object([("r", number()), ("g", number()), ("b", number()), ("a", number())]);
    let solid = || object([("pose", pose()), ("size", vector()), ("color", color())]);
    let cylinder = object([
        ("pose", pose()),
        ("size", vector()),
        ("bottom_scale", number()),
        ("top_scale", number()),
        ("color", color()),
    ]);
    let any = || list(json!({"type": "object"}));
    let entity = object([
        ("timestamp", stamp("time")),
        ("frame_id", json!({"type": "string"})),
        ("id", json!({"type": "string"})),
        ("lifetime", stamp("duration")),
        ("frame_locked", json!({"type": "boolean"})),
        ("metadata", any()),
        ("arrows", any()),
        ("cubes", list(solid())),
        ("spheres", list(solid())),
        ("cylinders", list(cylinder)),
        ("lines", any()),
        ("triangles", any()),
        ("texts", any()),
        ("models", any()),
    ]);
    titled("foxglove.SceneUpdate", object([("deletions", any()), ("entities", list(entity))]))
}

fn state_schema() -> Value {
    let joint = || {
        object([
            ("reference_deg", number()),
            ("true_deg", number()),
            ("error_deg", number()),
            ("drive", json!({"type": "number", "description": "fraction of the PWM period, signed by direction"})),
        ])
    };
    titled(
        "twum.NeckState",
        object([
            ("exercise", json!({"type": "string"})),
            ("time_s", number()),
            ("joint1", joint()),
            ("joint2", joint()),
            ("joint3", joint()),
            ("reference_m", vector()),
            ("true_m", vector()),
            ("error_m", number()),
        ]),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::session;
    use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
    use std::collections::HashMap;
    use std::io::Cursor;

    fn file(sessions: &[&Session]) -> Vec<u8> {
        let mut bytes = Vec::new();
        write(sessions, Cursor::new(&mut bytes)).unwrap();
        bytes
    }

    /// Walks from a frame to the base through the transforms known, as a viewer does.
    fn in_base(known: &HashMap<String, (String, Isometry3<f64>)>, frame: &str) -> Isometry3<f64> {
        let mut pose = Isometry3::identity();
        let mut frame = frame;
        while frame != BASE_FRAME {
            let (parent, step) = &known[frame];
            pose = step * pose;
            frame = parent;
        }
        pose
    }

    #[test]
    fn the_transforms_put_the_head_where_the_kinematics_does() {
        let session = session("flexion-extension");
        let bytes = file(&[&session]);
        let mut known = HashMap::new();
        let mut compared = 0;
        for message in mcap::MessageStream::new(&bytes).unwrap() {
            let message = message.unwrap();
            let json: Value = serde_json::from_slice(&message.data).unwrap();
            let schema = message.channel.schema.as_ref().unwrap();
            if message.channel.topic == TOPIC_TRANSFORMS {
                assert_eq!((schema.name.as_str(), schema.encoding.as_str()), ("foxglove.FrameTransform", "jsonschema"));
                let number = |object: &str, key: &str| json[object][key].as_f64().unwrap();
                let turn = ["w", "x", "y", "z"].map(|key| number("rotation", key));
                let pose = Isometry3::from_parts(
                    Translation3::new(
                        number("translation", "x"),
                        number("translation", "y"),
                        number("translation", "z"),
                    ),
                    UnitQuaternion::from_quaternion(Quaternion::new(turn[0], turn[1], turn[2], turn[3])),
                );
                let stamp = json["timestamp"]["sec"].as_u64().unwrap() * 1_000_000_000
                    + json["timestamp"]["nsec"].as_u64().unwrap();
                assert_eq!(stamp, message.log_time);
                let name = |key: &str| json[key].as_str().unwrap().to_owned();
                known.insert(name("child_frame_id"), (name("parent_frame_id"), pose));
            } else if message.channel.topic == TOPIC_STATE {
                let tick = (json["time_s"].as_f64().unwrap() / session.tick_s).round() as usize;
                for (frame, pose) in
                    [("true/head", session.joints_deg(tick)), ("reference/head", session.reference_deg(tick))]
                {
                    let [first, second, third] = session.wrist.frames(pose);
                    let difference = in_base(&known, frame).inverse() * (first * second * third);
                    assert!(difference.translation.vector.norm() < 1e-12 && difference.rotation.angle() < 1e-7);
                }
                compared += 1;
            }
        }
        assert_eq!(compared, 22 * 50 + 1);
    }

    #[test]
    fn heads_ride_on_frames_that_exist_and_sessions_follow_one_another() {
        let (one, two) = (session("lateral-flexion"), session("rotation"));
        let bytes = file(&[&one, &two]);
        let mut frames = std::collections::HashSet::new();
        let (mut heads, mut last, mut exercises) = (Vec::new(), 0, Vec::new());
        for message in mcap::MessageStream::new(&bytes).unwrap() {
            let message = message.unwrap();
            assert!(message.log_time >= last, "time runs backwards");
            last = message.log_time;
            let json: Value = serde_json::from_slice(&message.data).unwrap();
            match message.channel.topic.as_str() {
                TOPIC_TRANSFORMS => _ = frames.insert(json["child_frame_id"].as_str().unwrap().to_owned()),
                TOPIC_SCENE => {
                    heads.extend(
                        json["entities"].as_array().unwrap().iter().map(|e| e["frame_id"].as_str().unwrap().to_owned()),
                    );
                }
                _ => exercises.push(json["exercise"].as_str().unwrap().to_owned()),
            }
        }
        exercises.dedup();
        assert_eq!(exercises, ["lateral-flexion", "rotation"]);
        assert_eq!(heads.len(), 4);
        assert!(heads.iter().all(|frame| frames.contains(frame)));
        assert_eq!(last - VIRTUAL_EPOCH_NS, 45_000_000_000);
    }

    #[test]
    fn equal_sessions_give_equal_bytes() {
        assert_eq!(file(&[&session("rotation")]), file(&[&session("rotation")]));
    }
}
