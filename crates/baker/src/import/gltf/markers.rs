//! Probes and volumes that artists marked by custom properties: `extras.gdibl_probe` and `extras.gdibl_volume`.
//! They count on ignored nodes too: who writes one means it. Other `gdibl_*` properties of a volume are settings of its own.

use std::path::Path;

use glam::{DQuat, DVec3};
use serde_json::Value;

use super::document::Document;
use super::findings::Findings;
use super::hierarchy::PlacedNode;
use super::properties;
use crate::Result;
use crate::scene::{ProbeMarker, VolumeMarker};

/// The markers of `nodes`, in their order.
pub(super) fn read(
    document: &Document,
    nodes: &[PlacedNode],
    findings: &mut Findings,
) -> Result<(Vec<ProbeMarker>, Vec<VolumeMarker>)> {
    let (mut probes, mut volumes) = (Vec::new(), Vec::new());
    let folder = document.path.parent().unwrap_or(Path::new(""));
    for placed in nodes {
        let node = &document.nodes[placed.node];
        let label = document.node_label(placed.node);
        let name = node.name.clone().unwrap_or_default();
        if let Some(value) = node.extras.get("gdibl_probe") {
            let file = value.as_str().filter(|file| !file.is_empty()).ok_or_else(|| {
                document.invalid(format!("{label}: extras.gdibl_probe is {value}; expected a file name"))
            })?;
            let rotation = world_rotation(placed).ok_or_else(|| {
                document.invalid(format!("{label}: a probe on a node of scale 0 has no orientation; give it scale 1"))
            })?;
            probes.push(ProbeMarker {
                name: name.clone(),
                image: folder.join(file),
                position: placed.transform.translation,
                rotation,
            });
        }
        if let Some(value) = node.extras.get("gdibl_volume") {
            let spacing = value.as_f64().filter(|&s| s.is_finite() && s > 0.0).ok_or_else(|| {
                document
                    .invalid(format!("{label}: extras.gdibl_volume is {value}; expected a spacing in metres, over 0"))
            })?;
            let marker = VolumeMarker {
                name,
                node: label,
                spacing,
                center: placed.transform.translation,
                half_axes: placed.transform.matrix3,
                settings: settings_of(&node.extras),
            };
            check_box(&marker, document, findings)?;
            volumes.push(marker);
        }
    }
    Ok((probes, volumes))
}

/// An empty box is refused; that of a node that is rotated or skewed becomes the box around it.
fn check_box(marker: &VolumeMarker, document: &Document, findings: &mut Findings) -> Result<()> {
    let VolumeMarker { node, .. } = marker;
    let (min, max) = marker.bounds();
    let [x, y, z] = (max - min).to_array();
    if [x, y, z].contains(&0.0) {
        return Err(document.invalid(format!(
            "{node}: the box of its gdibl_volume is {x} x {y} x {z} m, which is empty; scale the node on all axes"
        )));
    }
    findings.add("rotated-volume", u64::from(!marker.is_upright()), || {
        format!(
            "{node}: its gdibl_volume is rotated or skewed; volumes lie along the world's axes, so the box around it is baked: \
             {x:.3} x {y:.3} x {z:.3} m"
        )
    });
    Ok(())
}

/// The settings of a volume, sorted by name, with their values as texts of flags.
fn settings_of(extras: &Value) -> Vec<(String, String)> {
    let own = extras.as_object().into_iter().flatten().filter(|(key, _)| !properties::KEYS.contains(&key.as_str()));
    let own = own.filter_map(|(key, value)| Some((key.strip_prefix(properties::OURS)?.to_owned(), text_of(value))));
    let mut own: Vec<(String, String)> = own.collect();
    own.sort();
    own
}

/// Arrays as lists with commas. Whole numbers without a fraction, since some programs write all numbers with one.
fn text_of(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(values) => values.iter().map(text_of).collect::<Vec<_>>().join(","),
        Value::Number(number) if number.is_f64() => number.as_f64().map_or_else(String::new, |n| n.to_string()),
        other => other.to_string(),
    }
}

/// The rotation nearest to what the node's axes say: X and Y made perpendicular, scale and mirroring left out.
fn world_rotation(placed: &PlacedNode) -> Option<DQuat> {
    let linear = placed.transform.matrix3;
    let x: DVec3 = linear.x_axis.try_normalize()?;
    let y = (linear.y_axis - x * x.dot(linear.y_axis)).try_normalize()?;
    Some(DQuat::from_mat3(&glam::DMat3::from_cols(x, y, x.cross(y))).normalize())
}
