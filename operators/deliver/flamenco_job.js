// SPDX-License-Identifier: GPL-3.0-or-later
// A job type for Flamenco 3: plans a crowd's LODs, bakes them, renders in chunks, and puts a report together.
// Copy it into the folder "scripts" beside Flamenco Manager. Workers that plan, bake and assemble need Crowd LOD in
// their Blender; those that render do not.

const JOB_TYPE = {
    label: "Crowd LOD",
    description: "Plan and bake a crowd's levels of detail, then render",
    settings: [
        { key: "frames", type: "string", required: true, visible: "submission",
          eval: "f'{C.scene.frame_start}-{C.scene.frame_end}'",
          evalInfo: { showLinkButton: true, description: "Scene frame range" },
          description: "First and last frame, such as 1-120" },
        { key: "step", type: "int32", default: 1, visible: "submission",
          eval: "C.scene.frame_step", evalInfo: { showLinkButton: true, description: "Scene frame step" },
          description: "Render every so many frames" },
        { key: "chunk_size", type: "int32", default: 10, visible: "submission", description: "Frames of a task" },
        { key: "output", type: "string", subtype: "dir_path", required: true, visible: "submission",
          description: "Folder for plan, frames and report" },
        { key: "engine", type: "string", default: "SCENE", choices: ["SCENE", "CYCLES", "EEVEE", "WORKBENCH"], visible: "submission",
          description: "What renders the frames" },
        { key: "blendfile", type: "string", required: true, visible: "web", eval: "bpy.data.filepath",
          description: "The scene with the crowd" },
    ],
};

const ENGINES = { CYCLES: "CYCLES", EEVEE: "BLENDER_EEVEE", WORKBENCH: "BLENDER_WORKBENCH" };

function compileJob(job) {
    const settings = job.settings;
    const match = /^\s*(-?\d+)\s*-\s*(-?\d+)\s*$/.exec(settings.frames);
    if (!match || Number(match[1]) > Number(match[2])) {
        throw "The frames " + settings.frames + " are no range: give first and last frame, such as 1-120.";
    }
    if (Number(match[1]) < 0) {
        throw "The frames " + settings.frames + " begin below 0, which Blender counts from the last frame: "
            + "move the scene's frames.";
    }
    if (settings.chunk_size < 1) {
        throw "A task has " + settings.chunk_size + " frames: give at least 1.";
    }
    const step = settings.step || 1;
    let range = settings.frames;
    if (step > 1) {
        const numbers = [];
        for (let k = Number(match[1]); k <= Number(match[2]); k += step) numbers.push(k);
        range = numbers.join(",");
    }
    const output = settings.output.replace(/[\/\\]+$/, "");
    const frames = ["--frames", match[1] + ":" + match[2]];
    const stepped = frames.concat(["--step", String(step)]);
    const baked = output + "/baked.blend";

    const plan = crowdTask("plan", ["plan", settings.blendfile].concat(frames, ["--out", output + "/plan"]));
    const bake = crowdTask("bake", ["build", settings.blendfile, "--bake", "--render-only"].concat(
        stepped, ["--plan", output + "/plan", "--out", baked]));
    bake.addDependency(plan);
    const assemble = crowdTask("assemble", ["assemble", output].concat(stepped));

    job.addTask(plan);
    job.addTask(bake);
    for (const chunk of frameChunker(range, settings.chunk_size)) {
        const task = author.Task("render-" + chunk, "blender");
        const engine = ENGINES[settings.engine] ? ["--engine", ENGINES[settings.engine]] : [];
        task.addCommand(author.Command("blender-render", {
            exe: "{blender}",
            exeArgs: "{blenderArgs}",
            argsBefore: [],
            blendfile: baked,
            args: engine.concat([
                "--render-output", output + "/frames/####",
                "--render-format", "PNG",
                "--render-frame", chunk.replaceAll("-", ".."),
            ]),
        }));
        task.addDependency(bake);
        assemble.addDependency(task);
        job.addTask(task);
    }
    job.addTask(assemble);
}

// A task of Crowd LOD's own commands, in a Blender that has the extension.
function crowdTask(name, words) {
    const task = author.Task(name, "misc");
    task.addCommand(author.Command("exec", {
        exe: "{blender}",
        args: ["--background", "--command", "crowd_lod"].concat(words),
    }));
    return task;
}
