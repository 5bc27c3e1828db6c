// Reads .gdibl irradiance volumes in a page or in Node, by the module gdibl_runtime_c.wasm beside this file. To build it:
//
//   rustup target add wasm32-unknown-unknown
//   cargo rustc -p gdibl-runtime-c --lib --crate-type cdylib --target wasm32-unknown-unknown --profile wasm \
//     --no-default-features
//   cp target/wasm32-unknown-unknown/wasm/gdibl_runtime_c.wasm integrations/web/
//
//   const gdibl = await loadGdibl();
//   const volume = gdibl.parse( new Uint8Array( await ( await fetch( 'level.gdibl' ) ).arrayBuffer() ) );
//   const [ r, g, b ] = volume.irradiance( [ 1, 1.5, - 2 ], [ 0, 1, 0 ] );
//   volume.free();
//
// Several volumes of a level, by their list:
//
//   const list = await ( await fetch( 'level.volumes.json' ) ).json();
//   const bytes = ( file ) => fetch( file ).then( ( answer ) => answer.arrayBuffer() ).then( ( buffer ) => new Uint8Array( buffer ) );
//   const files = await Promise.all( list.volumes.map( ( { file } ) => bytes( file ) ) );
//   const set = gdibl.set( files.map( ( bytes ) => gdibl.parse( bytes ) ), list.volumes.map( ( { spacing } ) => spacing ) );
//
// Metres, glTF's axes, unit normals. Irradiance E is what falls on a surface, in linear Rec.709: diffuse = albedo / π · E.
// Coefficients of crates/runtime-c/include/gdibl.h, which says more. A file compressed with zstd needs a module that was
// built with `--features zstd`; one built with `--features messages` also says what was found and what was expected where a
// file is damaged, one built with `--features fast` answers queries faster.

const KINDS = [ 'grid', 'points', 'vertices', 'sparse' ];
const MESSAGE_BYTES = 512;
const FLOAT = 4, POINTER = 4, HEADER_BYTES = 72, POSITION_BYTES = 24, SAMPLE_BYTES = 312, VALIDITY_AT = 304;

/** Loads the module from its bytes, or from the file of its name beside this one. */
export async function loadGdibl( bytes ) {

	bytes ??= await ( await fetch( new URL( 'gdibl_runtime_c.wasm', import.meta.url ) ) ).arrayBuffer();
	return new Gdibl( ( await WebAssembly.instantiate( bytes ) ).instance.exports );

}

class Gdibl {

	constructor( exports ) {

		this.exports = exports;

	}

	/** A volume from a file's bytes. Throws an Error that says what is wrong where. */
	parse( bytes ) {

		return this.borrow( [ bytes.length, POINTER, MESSAGE_BYTES ], ( file, pointer, message ) => {

			new Uint8Array( this.exports.memory.buffer ).set( bytes, file );
			const status = this.exports.gdibl_parse( file, bytes.length, pointer, message, MESSAGE_BYTES );
			const memory = new Uint8Array( this.exports.memory.buffer );
			if ( status !== 0 ) throw new Error( new TextDecoder().decode( memory.subarray( message, memory.indexOf( 0, message ) ) ) );
			return new Volume( this, new Uint32Array( memory.buffer, pointer, 1 )[ 0 ] );

		} );

	}

	/** Several volumes of a level as one, in the order of their list, each with its spacing of there. They are the set's then. */
	set( volumes, spacings ) {

		const count = volumes.length;
		if ( spacings.length !== count ) throw new RangeError( `${ count } volumes, ${ spacings.length } spacings` );
		return this.borrow( [ POINTER * count, 2 * FLOAT * count, POINTER ], ( addresses, numbers, pointer ) => {

			const { buffer } = this.exports.memory;
			new Uint32Array( buffer, addresses, count ).set( volumes.map( ( { address } ) => address ) );
			new Float64Array( buffer, numbers, count ).set( spacings );
			const status = this.exports.gdibl_set( addresses, numbers, count, pointer );
			if ( status !== 0 ) throw new RangeError( 'volumes of a set are grids, each once and not freed, with spacings over 0' );
			volumes.forEach( ( volume ) => { volume.address = 0; } );
			return new VolumeSet( this, new Uint32Array( this.exports.memory.buffer, pointer, 1 )[ 0 ] );

		} );

	}

	/** Into `result`, what the module's function says at positions with normals. `address`: of whom it asks. */
	ask( batch, address, positions, normals, result ) {

		const { exports } = this, length = positions.length, size = FLOAT * length;
		if ( address === 0 ) throw new Error( 'the volume was freed, or is part of a set' );
		if ( length % 3 !== 0 || normals.length !== length || result.length !== length ) {

			throw new RangeError( `${ length } numbers of positions, ${ normals.length } of normals, ${ result.length } of results` );

		}

		return this.borrow( [ size, size ], ( p, n ) => {

			new Float32Array( exports.memory.buffer, p, length ).set( positions );
			new Float32Array( exports.memory.buffer, n, length ).set( normals );
			exports[ batch ]( address, length / 3, p, n, p );
			result.set( new Float32Array( exports.memory.buffer, p, length ) );
			return result;

		} );

	}

	/** What `use( address… )` returns, given as many pieces of the module's memory as there are sizes in bytes. */
	borrow( sizes, use ) {

		const { gdibl_allocate, gdibl_deallocate } = this.exports;
		const addresses = sizes.map( ( size ) => gdibl_allocate( size ) );
		try {

			if ( addresses.includes( 0 ) ) throw new RangeError( `no memory for ${ sizes } bytes` );
			return use( ...addresses );

		} finally {

			addresses.forEach( ( address, k ) => gdibl_deallocate( address, sizes[ k ] ) );

		}

	}

}

class Volume {

	constructor( gdibl, address ) {

		Object.assign( this, { gdibl, address, nodeCount: gdibl.exports.gdibl_node_count( address ) } );
		this.header = gdibl.borrow( [ HEADER_BYTES ], ( at ) => {

			gdibl.exports.gdibl_header( address, at );
			const view = new DataView( gdibl.exports.memory.buffer, at, HEADER_BYTES );
			const three = ( read, start, size ) => [ 0, 1, 2 ].map( ( k ) => view[ read ]( start + k * size, true ) );
			return { kind: KINDS[ view.getUint32( 0, true ) ], counts: three( 'getUint32', 4, 4 ), bands: view.getUint32( 16, true ),
				isDeringed: view.getUint8( 20 ) !== 0, min: three( 'getFloat64', 24, 8 ), max: three( 'getFloat64', 48, 8 ) };

		} );

	}

	/** Irradiance (red, green, blue) at a position with a unit normal. Many at once go faster through irradianceBatch. */
	irradiance( position, normal ) {

		return this.irradianceBatch( position, normal );

	}

	/** Irradiance at positions (x, y, z after x, y, z) with as many normals, into `result`, which is returned. */
	irradianceBatch( positions, normals, result = new Float32Array( positions.length ) ) {

		return this.gdibl.ask( 'gdibl_irradiance_batch', this.address, positions, normals, result );

	}

	/**
	 * Nodes `from` up to, not including, `to`: `positions` (x, y, z after x, y, z), `validity` (1 where a node was baked, 0 where
	 * it was filled from its neighbours), and `irradiance`, for each node at each of these unit normals.
	 */
	nodes( from, to, normals = new Float32Array( 0 ) ) {

		const { exports } = this.gdibl, count = to - from, directions = normals.length / 3;
		if ( this.address === 0 ) throw new Error( 'the volume was freed' );
		if ( ! ( from >= 0 && from <= to && to <= this.nodeCount ) ) throw new RangeError( `nodes ${ from } to ${ to } of ${ this.nodeCount }` );
		const found = { positions: new Float64Array( 3 * count ), validity: new Uint8Array( count ), irradiance: new Float32Array( 3 * count * directions ) };
		const sizes = [ POSITION_BYTES * count, SAMPLE_BYTES, FLOAT * normals.length, FLOAT * found.irradiance.length ];
		return this.gdibl.borrow( sizes, ( places, sample, normal, light ) => {

			const memory = exports.memory.buffer;
			new Float32Array( memory, normal, normals.length ).set( normals );
			const validity = new Float32Array( memory, sample + VALIDITY_AT, 1 );
			for ( let k = 0; k < count; k ++ ) {

				exports.gdibl_node( this.address, from + k, places + POSITION_BYTES * k, sample );
				found.validity[ k ] = validity[ 0 ];
				for ( let n = 0; n < directions; n ++ ) exports.gdibl_evaluate( sample, normal + 3 * FLOAT * n, light + 3 * FLOAT * ( k * directions + n ) );

			}

			found.positions.set( new Float64Array( memory, places, 3 * count ) );
			found.irradiance.set( new Float32Array( memory, light, found.irradiance.length ) );
			return found;

		} );

	}

	/** Gives the volume's memory back. */
	free() {

		this.gdibl.exports.gdibl_free( this.address );
		this.address = 0;

	}

}

/** Several volumes of a level: light is continuous across their borders, and the finer one wins. */
class VolumeSet {

	constructor( gdibl, address ) {

		Object.assign( this, { gdibl, address } );

	}

	/** As of a volume. */
	irradiance( position, normal ) {

		return this.irradianceBatch( position, normal );

	}

	/** As of a volume. */
	irradianceBatch( positions, normals, result = new Float32Array( positions.length ) ) {

		return this.gdibl.ask( 'gdibl_set_irradiance_batch', this.address, positions, normals, result );

	}

	/** Gives the memory of the set and its volumes back. */
	free() {

		this.gdibl.exports.gdibl_set_free( this.address );
		this.address = 0;

	}

}
