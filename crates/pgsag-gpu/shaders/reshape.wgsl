// Gathers one band of a cloud after clone, split and prune.

struct Reshape {
    before: u32,
    after: u32,
    kept: u32,
    planes: u32,
    band: u32,
    moments: u32,
    has_ceiling: u32,
    ceiling: f32,
}

@group(0) @binding(0) var<uniform> plan: Reshape;
@group(0) @binding(1) var<storage, read> parents: array<u32>;
// Six numbers per birth: offset, shift of the log scales, whether there is a logit, the logit.
@group(0) @binding(2) var<storage, read> births: array<f32>;
@group(0) @binding(3) var<storage, read> old: array<f32>;
@group(0) @binding(4) var<storage, read_write> fresh: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let at = (group.y * groups.x + group.x) * 256u + lane;
    if at >= plan.planes * plan.after {
        return;
    }
    let plane = at / plan.after;
    let i = at % plan.after;
    var value = old[plane * plan.before + parents[i]];
    let is_opacity = plan.band == 0u && plane == 10u;
    if i >= plan.kept {
        let birth = 6u * (i - plan.kept);
        if plan.moments != 0u {
            value = 0.0;
        } else if plan.band == 0u && plane < 3u {
            value += births[birth + plane];
        } else if plan.band == 0u && plane < 6u {
            value += births[birth + 3u];
        } else if is_opacity && births[birth + 4u] != 0.0 {
            value = births[birth + 5u];
        }
    }
    if is_opacity && plan.has_ceiling != 0u {
        value = select(min(value, plan.ceiling), 0.0, plan.moments != 0u);
    }
    fresh[at] = value;
}
