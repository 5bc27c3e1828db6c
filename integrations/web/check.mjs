// Compares the WebAssembly module with answers of the Rust runtime, in Node: crates/runtime-c/tests/wasm.rs calls it.
//
//   node check.mjs MODULE.wasm FILE.gdibl QUERIES TOLERANCE
//
// QUERIES holds 32-bit floats, little-endian: all positions, all normals, all irradiances.
// Prints JSON: what the header says, how many queries there were, the largest difference.
import { strict as assert } from 'node:assert';
import { readFileSync } from 'node:fs';
import { loadGdibl } from './gdibl.mjs';

const [ module, file, queries, tolerance ] = process.argv.slice( 2 );
const gdibl = await loadGdibl( readFileSync( module ) );
const bytes = readFileSync( file );

// Damaged files are errors that name the place, and leave the module as it was.
for ( let cut = 0; cut < bytes.length; cut += 97 ) assert.throws( () => gdibl.parse( bytes.subarray( 0, cut ) ), /^Error: invalid volume: (first bytes|end of file|section |header)/ );
const volume = gdibl.parse( bytes );

const numbers = new Float32Array( new Uint8Array( readFileSync( queries ) ).buffer );
const count = numbers.length / 9;
assert( count > 0 && Number.isInteger( count ) );
const part = ( k ) => numbers.subarray( 3 * count * k, 3 * count * ( k + 1 ) );
const [ positions, normals, truth ] = [ 0, 1, 2 ].map( part );

// Many at once, and one by one.
const batch = volume.irradianceBatch( positions, normals );
let largest = 0;
for ( let k = 0; k < count; k ++ ) {

	const [ start, end ] = [ 3 * k, 3 * k + 3 ];
	const single = volume.irradiance( positions.subarray( start, end ), normals.subarray( start, end ) );
	assert.deepEqual( single, batch.slice( start, end ) );
	for ( let c = start; c < end; c ++ ) {

		const difference = Math.abs( batch[ c ] - truth[ c ] );
		assert( difference <= Number( tolerance ), `query ${ k }: found ${ single }, expected ${ truth.subarray( start, end ) }` );
		largest = Math.max( largest, difference );

	}

}

// A set of one is that volume; what is no set is refused and leaves the volume.
const one = gdibl.parse( bytes );
assert.throws( () => gdibl.set( [ one ], [ 0 ] ), /grids/ );
if ( one.header.kind === 'grid' ) {

	const set = gdibl.set( [ one ], [ 1 ] );
	assert.deepEqual( set.irradianceBatch( positions, normals ), batch );
	assert.throws( () => one.irradiance( [ 0, 0, 0 ], [ 0, 1, 0 ] ), /part of a set/ );
	set.free();

} else {

	assert.throws( () => gdibl.set( [ one ], [ 1 ] ), /grids/ );
	one.free();

}

// Nodes say what the volume says where they are, unless a wall or a neighbour has a share in it.
const up = new Float32Array( [ 0, 1, 0, 1, 0, 0 ] );
const nodes = volume.nodes( 0, volume.nodeCount, up );
assert.equal( nodes.positions.length, 3 * volume.nodeCount );
const { min, max } = volume.header;
nodes.positions.forEach( ( p, k ) => assert( p >= min[ k % 3 ] - 1e-6 && p <= max[ k % 3 ] + 1e-6 ) );
assert( nodes.irradiance.every( Number.isFinite ) && nodes.validity.every( ( v ) => v <= 1 ) );
const fourth = volume.nodes( 3, 4, up );
assert.deepEqual( fourth.irradiance, nodes.irradiance.slice( 18, 24 ) );
assert.deepEqual( fourth.positions, nodes.positions.slice( 9, 12 ) );
assert.throws( () => volume.nodes( 0, volume.nodeCount + 1 ), /nodes 0 to/ );

// What was freed is used again: as many volumes as would fill the memory otherwise.
const before = gdibl.exports.memory.buffer.byteLength;
for ( let k = 0; k < 1000; k ++ ) gdibl.parse( bytes ).free();
assert( gdibl.exports.memory.buffer.byteLength <= before + ( 1 << 20 ) );

console.log( JSON.stringify( { header: volume.header, nodes: volume.nodeCount, queries: count, largest } ) );
volume.free();
assert.throws( () => volume.irradiance( [ 0, 0, 0 ], [ 0, 1, 0 ] ), /freed/ );
